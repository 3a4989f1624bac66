//! Runs every reader briefly on mutated and random files. `make fuzz` runs longer and is
//! coverage-guided.

use isoparticles_stage::error::Error;
use isoparticles_tests::readers::{Feeder, READERS, Reader};
use isoparticles_volume::read_volume;
use proptest::prelude::*;
use std::path::{Path, PathBuf};
use std::sync::LazyLock;

static FIXTURES: LazyLock<Vec<(String, Vec<u8>)>> = LazyLock::new(|| {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("../common");
    let volume = ["nrrd", "nifti", "analyze", "mgh", "npy", "tiff", "vti", "meta", "segmentation"];
    let dicom = ["dicom_objects", "dicom_objects/contours"];
    let mut paths: Vec<PathBuf> = [&volume[..], &dicom]
        .concat()
        .into_iter()
        .map(|folder| format!("volume/tests/data/{folder}"))
        .chain(["golden", "edited"].map(|folder| format!("stage/tests/data/{folder}")))
        .flat_map(|folder| std::fs::read_dir(root.join(folder)).expect("fixtures"))
        .map(|entry| entry.expect("entry").path())
        .filter(|path| path.is_file())
        .collect();
    paths.sort();
    let name = |path: &Path| path.file_name().expect("a name").to_string_lossy().into_owned();
    paths.iter().map(|path| (name(path), std::fs::read(path).expect("fixture"))).collect()
});

thread_local! {
    static FEEDERS: [Feeder; READERS.len()] = READERS.map(Feeder::new);
}

/// Runs every reader on a file with this name and these bytes.
fn read_all(name: &str, bytes: &[u8]) {
    FEEDERS.with(|feeders| feeders.iter().for_each(|feeder| feeder.feed_file(name, bytes)));
}

/// Applies truncations, insertions and replacements to bytes.
fn changed(bytes: &[u8], changes: Vec<(prop::sample::Index, u8, u8)>) -> Vec<u8> {
    let mut bytes = bytes.to_vec();
    for (at, byte, how) in changes {
        let at = at.index(bytes.len().max(1)).min(bytes.len());
        match how {
            0 => bytes.truncate(at),
            1 => bytes.insert(at, byte),
            _ => {
                if let Some(place) = bytes.get_mut(at) {
                    *place = byte;
                }
            }
        }
    }
    bytes
}

/// Returns a strategy that generates valid and invalid lines of an NRRD header.
fn header_line() -> impl Strategy<Value = String> {
    let fields = [
        "type",
        "dimension",
        "sizes",
        "encoding",
        "endian",
        "space",
        "space directions",
        "space origin",
        "kinds",
        "spacings",
        "axis mins",
        "axis maxs",
        "centers",
        "line skip",
        "byte skip",
        "data file",
        "space dimension",
        "Segment0_Name:=x\nSegment0_Layer:=",
        "Segment1_Name:=y\nSegment1_LabelValue:=",
    ];
    let values = [
        "short",
        "double",
        "3",
        "2 2 2",
        "4",
        "1 2 2 2",
        "raw",
        "list domain domain domain",
        "gzip",
        "hex",
        "ascii",
        "bzip2",
        "little",
        "big",
        "LPS",
        "RAST",
        "none (1,0,0) (0,1,0) (0,0,1)",
        "(1,0,0) (0,1,0) (0,0,1)",
        "(nan,0,0) (0,inf,0) (0,0,-0)",
        "(((",
        "(1,2",
        "nan nan nan",
        "1e308 1e308 1e308",
        "-1",
        "99999999999999999999",
        "x%d.raw 1 3 1",
        "%99999d 1 2 1",
        "LIST",
        "LIST 0",
        "LIST 9",
        "domain domain domain",
        "",
        "é",
        "\u{0}",
    ];
    (prop::sample::select(fields.to_vec()), prop::sample::select(values.to_vec()))
        .prop_map(|(f, v)| format!("{f}: {v}\n"))
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 600, failure_persistence: None, ..ProptestConfig::default() })]

    #[test]
    fn changed_fixtures_are_read_or_refused(
        which in any::<prop::sample::Index>(),
        changes in prop::collection::vec((any::<prop::sample::Index>(), any::<u8>(), 0..4u8), 1..6),
    ) {
        let (name, bytes) = which.get(&FIXTURES[..]);
        read_all(name, &changed(bytes, changes));
    }

    #[test]
    fn any_header_is_read_or_refused(lines in prop::collection::vec(header_line(), 0..14), tail: Vec<u8>) {
        let text = format!("NRRD0004\n{}\n", lines.concat());
        read_all("any.nrrd", &[text.as_bytes(), &tail].concat());
    }

    #[test]
    fn any_bytes_are_read_or_refused(bytes: Vec<u8>, which in 0..11usize) {
        let names = ["a.nrrd", "a.nii", "a.nii.gz", "a.vti", "a.vtp", "a.bin", "a.mha", "a.dcm", "a.tif", "a.npy", "a.mgh"];
        let slice = [&[0; 128][..], b"DICM"].concat();
        let starts: [&[u8]; 11] = [
            b"NRRD0005\n", &[0x5c, 1, 0, 0], &[0x1f, 0x8b, 8], b"<VTKFile", b"<VTKFile ", b"ISOPART\n", b"NDims = 3\n", &slice,
            b"II*\0\x08\0\0\0", b"\x93NUMPY\x01\0", &[0, 0, 0, 1, 0, 0, 0],
        ];
        read_all(names[which], &[starts[which], &bytes].concat());
    }
}

// Each case writes and reads two files.
proptest! {
    #![proptest_config(ProptestConfig { cases: 400, failure_persistence: None, ..ProptestConfig::default() })]

    #[test]
    fn a_series_with_a_changed_slice_is_read_or_refused(
        (series, slice, changed_slice) in prop::sample::select(vec![
            ("dicom/oblique", "a.dcm", "b.dcm"),
            ("dicom/rle", "a.dcm", "b.dcm"),
            // a scan and its contours
            ("dicom_objects/structures", "0.dcm", "rs.dcm"),
        ]),
        changes in prop::collection::vec((any::<prop::sample::Index>(), any::<u8>(), 0..4u8), 1..6),
    ) {
        let from = Path::new(env!("CARGO_MANIFEST_DIR")).join("../common/volume/tests/data").join(series);
        let folder = tempfile::tempdir().expect("folder");
        std::fs::copy(from.join(slice), folder.path().join("a.dcm")).expect("copied");
        let bytes = std::fs::read(from.join(changed_slice)).expect("fixture");
        std::fs::write(folder.path().join("b.dcm"), changed(&bytes, changes)).expect("written");
        if let Err(error) = read_volume(folder.path()).map_err(Error::from) {
            assert!(!error.what.is_empty() && !error.why.is_empty() && !error.next.is_empty(), "{error}");
        }
    }
}

/// Runs the readers on `tests/data/found/NUMBER.READER`, the inputs with which fuzzing exposed
/// faults. There is one file per fault.
#[test]
fn what_was_found_stays_found() {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("data/found");
    for entry in std::fs::read_dir(folder).expect("the folder of finds") {
        let path = entry.expect("entry").path();
        let name = path.extension().and_then(|name| name.to_str()).unwrap_or_default();
        if name != "md" {
            Reader::named(name).feed(&std::fs::read(&path).expect("a find"));
        }
    }
}
