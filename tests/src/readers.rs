//! Every reader of files, under one name each, for tests that feed them anything: whatever the bytes, a reader gives a value or an
//! error in three parts; it never panics and never takes memory that the file does not fill.

use isoparticles_mesh::point_cloud::read_point_cloud;
use isoparticles_mesh::surface::read_surface;
use isoparticles_stage::error::Error;
use isoparticles_stage::field_file::{FieldKind, read_field};
use isoparticles_stage::materials_file::read_materials;
use isoparticles_stage::particle_file::{ParticleKind, read_particles};
use isoparticles_volume::{data_files, read_volume};
use std::path::Path;
use tempfile::TempDir;

/// A reader and the endings of the files that it is given.
#[derive(Clone, Copy, Debug)]
pub struct Reader {
    /// Name, that of its fuzz target.
    pub name: &'static str,
    /// Ending of the file's name.
    pub ending: &'static str,
    read: fn(&Path) -> Option<Error>,
}

fn volume(path: &Path) -> Option<Error> {
    // what `make` asks before the volume is read
    drop(data_files(path));
    read_volume(path).err().map(Error::from)
}

/// The folder of slices that the file lies in.
fn series(path: &Path) -> Option<Error> {
    read_volume(path.parent()?).err().map(Error::from)
}

fn field(path: &Path) -> Option<Error> {
    read_field(path, FieldKind::Sizing).err()
}

fn materials(path: &Path) -> Option<Error> {
    read_materials(path).err()
}

fn particles(path: &Path) -> Option<Error> {
    read_particles(path, &[ParticleKind::Seeds, ParticleKind::Checkpoint]).err()
}

fn surface(path: &Path) -> Option<Error> {
    read_surface(path).err().map(Error::from)
}

fn cloud(path: &Path) -> Option<Error> {
    read_point_cloud(path).err().map(Error::from)
}

const fn reader(name: &'static str, ending: &'static str, read: fn(&Path) -> Option<Error>) -> Reader {
    Reader { name, ending, read }
}

/// All of them.
pub const READERS: [Reader; 15] = [
    reader("nrrd", "nrrd", volume),
    reader("nifti", "nii", volume),
    reader("compressed_nifti", "nii.gz", volume),
    reader("meta_image", "mha", volume),
    reader("vtk_image", "vti", volume),
    reader("dicom", "dcm", series),
    reader("field", "vti", field),
    reader("materials", "vti", materials),
    reader("particles", "bin", particles),
    reader("surface", "vtp", surface),
    reader("cloud_of_ply", "ply", cloud),
    reader("cloud_of_text", "xyz", cloud),
    reader("cloud_of_polygons", "vtp", cloud),
    reader("cloud_of_legacy_vtk", "vtk", cloud),
    reader("any_volume", "unknown", volume),
];

impl Reader {
    /// The reader of a name.
    ///
    /// # Panics
    /// When there is none: a slip in a test.
    pub fn named(name: &str) -> Self {
        *READERS.iter().find(|reader| reader.name == name).unwrap_or_else(|| panic!("no reader is called {name}"))
    }

    /// Feeds it a file with these bytes.
    ///
    /// # Panics
    /// When it does, or its error has not all three parts.
    pub fn feed(self, bytes: &[u8]) {
        Feeder::new(self).feed(bytes);
    }
}

/// A reader and a folder for what it is fed, which one file after the other is written into.
#[derive(Debug)]
pub struct Feeder {
    reader: Reader,
    folder: TempDir,
}

impl Feeder {
    /// A folder for a reader, among the temporary files.
    ///
    /// # Panics
    /// When it cannot be made.
    pub fn new(reader: Reader) -> Self {
        Self { reader, folder: tempfile::tempdir().expect("a folder for files") }
    }

    /// Feeds a file with these bytes: to the reader of series a folder of slices, to that of particles the file that is sealed, too.
    ///
    /// # Panics
    /// When the reader does, or its error has not all three parts.
    pub fn feed(&self, bytes: &[u8]) {
        let name = format!("file.{}", self.reader.ending);
        if self.reader.ending != "dcm" {
            self.feed_file(&name, bytes);
            if let Some(sealed) = sealed(bytes) {
                self.feed_file(&name, &sealed);
            }
            return;
        }
        let others: Vec<_> = slices(bytes)
            .enumerate()
            .map(|(number, slice)| (self.folder.path().join(format!("{number}.dcm")), slice))
            .collect();
        for (path, slice) in &others {
            std::fs::write(path, slice).expect("a slice to read");
        }
        // the reader wants the folder of a file, whether that is there or not
        self.read(&self.folder.path().join(name));
        for (path, _) in &others {
            std::fs::remove_file(path).expect("a slice that is there");
        }
    }

    /// Feeds a file of this name.
    ///
    /// # Panics
    /// As [`Feeder::feed`].
    pub fn feed_file(&self, name: &str, bytes: &[u8]) {
        let path = self.folder.path().join(name);
        std::fs::write(&path, bytes).expect("a file to read");
        self.read(&path);
    }

    fn read(&self, path: &Path) {
        if let Some(error) = (self.reader.read)(path) {
            assert!(
                !error.what.is_empty() && !error.why.is_empty() && !error.next.is_empty(),
                "{}: {error}",
                self.reader.name
            );
        }
    }
}

/// A file of particles with the length and the checksum of what it holds (`particle_file.rs`), which no chance hits on; `None` of others.
fn sealed(bytes: &[u8]) -> Option<Vec<u8>> {
    let (head, _) = bytes.split_at_checked(16).filter(|(head, _)| head.starts_with(b"ISOPART\n"))?;
    let payload = bytes.get(56..)?;
    Some([head, &(payload.len() as u64).to_le_bytes(), blake3::hash(payload).as_bytes(), payload].concat())
}

/// Where a slice says what it is, from its start.
const SLICE_MAGIC: usize = 128;

/// Slices that stand one behind the other: each begins 128 bytes before its letters DICM. A volume is made of two slices and more, so that
/// one by itself is refused before its pixels are looked at.
fn slices(bytes: &[u8]) -> impl Iterator<Item = &[u8]> {
    let mut rest = Some(bytes);
    std::iter::from_fn(move || {
        let bytes = rest.take()?;
        let next =
            bytes.windows(4).skip(2 * SLICE_MAGIC).position(|window| window == b"DICM").map(|at| at + SLICE_MAGIC);
        let (slice, others) = bytes.split_at(next.unwrap_or(bytes.len()));
        rest = next.map(|_| others);
        Some(slice)
    })
}
