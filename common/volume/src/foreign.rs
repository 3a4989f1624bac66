//! Detects volumes in formats that the program `isoparticles-read` converts (pipelines/wheel).

use crate::error::Content;
use std::io::Read;
use std::path::Path;

/// First bytes of each format that has a signature.
const SIGNATURES: [(&[u8], Content); 3] = [
    (b"\x89HDF\r\n\x1a\n", Content::Hdf5),
    (b"MATLAB 5.0 MAT-file", Content::Matlab),
    // HDF5 after a block of text
    (b"MATLAB 7.3 MAT-file", Content::Matlab),
];
/// Each array and each group of a Zarr store contains one of these files.
const ZARR_FILES: [&str; 3] = ["zarr.json", ".zarray", ".zgroup"];

/// Returns the contents of a file or folder in a format that `isoparticles-read` converts, or
/// `None` for all other files.
pub fn foreign_content(path: &Path) -> Option<Content> {
    if path.is_dir() {
        return ZARR_FILES.iter().any(|name| path.join(name).is_file()).then_some(Content::Zarr);
    }
    let mut start = Vec::new();
    let longest = SIGNATURES.iter().map(|(signature, _)| signature.len()).max().unwrap_or_default();
    std::fs::File::open(path).ok()?.take(longest as u64).read_to_end(&mut start).ok()?;
    SIGNATURES.iter().find(|(signature, _)| start.starts_with(signature)).map(|(_, content)| *content)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{Error, read_volume};

    #[test]
    fn foreign_formats_name_the_program_that_converts_them() {
        let folder = tempfile::tempdir().expect("folder");
        let file = |name: &str, bytes: &[u8]| {
            let path = folder.path().join(name);
            std::fs::create_dir_all(path.parent().expect("a folder")).expect("made");
            std::fs::write(&path, bytes).expect("written");
            path
        };
        let hdf5 = file("scan.nrrd", b"\x89HDF\r\n\x1a\n\0\0\0\0");
        let matlab = file("a.mat", b"MATLAB 5.0 MAT-file, Platform: nt");
        file("a.zarr/.zgroup", b"{}");
        file("b.zarr/zarr.json", b"{}");
        let store = folder.path().join("a.zarr");
        let other = folder.path().join("b.zarr");
        let contents = [hdf5.as_path(), &matlab, &store, &other, folder.path()].map(foreign_content);
        let expected = [Some(Content::Hdf5), Some(Content::Matlab), Some(Content::Zarr), Some(Content::Zarr), None];
        assert_eq!(contents, expected);
        assert_eq!(foreign_content(&folder.path().join("missing.h5")), None);
        for path in [hdf5, matlab, store] {
            let error = read_volume(&path).expect_err("not read here");
            assert!(
                matches!(error, Error::NotAVolume { .. }) && error.remedy().contains("isoparticles-read"),
                "{error}"
            );
        }
    }
}
