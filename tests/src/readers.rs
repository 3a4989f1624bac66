//! Lists every file reader by name, for tests with arbitrary bytes. A reader must return a value or
//! a three-part error. It must never panic, and must not allocate memory for data that is not in
//! the file.

use glam::DVec3;
use isoparticles_mesh::point_cloud::read_point_cloud;
use isoparticles_mesh::surface::read_surface;
use isoparticles_stage::error::Error;
use isoparticles_stage::field_file::{FieldKind, read_field};
use isoparticles_stage::materials_file::read_materials;
use isoparticles_stage::particle_file::{ParticleKind, read_particles};
use isoparticles_volume::{ReadOptions, data_files, read_volume, read_volume_with};
use std::path::Path;
use tempfile::TempDir;

/// A reader and the file name extension that it supports.
#[derive(Clone, Copy, Debug)]
pub struct Reader {
    /// Name of the reader; the fuzz program reads it from the environment variable `READER`.
    pub name: &'static str,
    /// File name extension, without the dot.
    pub ending: &'static str,
    read: fn(&Path) -> Option<Error>,
}

fn volume(path: &Path) -> Option<Error> {
    // isoparticles-case calls `data_files` before a stage reads the volume.
    drop(data_files(path));
    read_volume(path).err().map(Error::from)
}

/// Reads a volume of a format without a spacing.
fn without_spacing(path: &Path) -> Option<Error> {
    let options = ReadOptions { spacing: Some(DVec3::ONE), ..ReadOptions::default() };
    read_volume_with(path, &options).err().map(Error::from)
}

/// Reads a header of 348 bytes and the voxels after it as two files.
fn pair(path: &Path) -> Option<Error> {
    let bytes = std::fs::read(path).ok()?;
    let (header, voxels) = bytes.split_at(bytes.len().min(348));
    let [head, body] = ["hdr", "img"].map(|ending| path.with_extension(ending));
    std::fs::write(&head, header).ok()?;
    std::fs::write(&body, voxels).ok()?;
    let error = volume(&head);
    std::fs::remove_file(&body).ok()?;
    error
}

/// Reads the parent folder of `path` as a series of slices.
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

/// All readers.
pub const READERS: [Reader; 21] = [
    reader("nrrd", "nrrd", volume),
    reader("nifti", "nii", volume),
    reader("compressed_nifti", "nii.gz", volume),
    reader("analyze", "hdr", pair),
    reader("mgh", "mgh", volume),
    reader("compressed_mgh", "mgz", volume),
    reader("tiff", "tif", without_spacing),
    reader("numpy", "npy", without_spacing),
    reader("meta_image", "mha", volume),
    reader("vtk_image", "vti", volume),
    reader("dicom", "dcm", series),
    reader("dicom_object", "dicom", volume),
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
    /// Returns the reader called `name`.
    ///
    /// # Panics
    /// Panics if no reader has this name.
    pub fn named(name: &str) -> Self {
        *READERS.iter().find(|reader| reader.name == name).unwrap_or_else(|| panic!("no reader is called {name}"))
    }

    /// Runs the reader on a file that contains `bytes`.
    ///
    /// # Panics
    /// Panics if the reader panics, or if its error lacks one of the three parts.
    pub fn feed(self, bytes: &[u8]) {
        Feeder::new(self).feed(bytes);
    }
}

/// A reader and a temporary folder for its input files.
#[derive(Debug)]
pub struct Feeder {
    reader: Reader,
    folder: TempDir,
}

impl Feeder {
    /// Creates a temporary folder for a reader.
    ///
    /// # Panics
    /// Panics if the folder cannot be created.
    pub fn new(reader: Reader) -> Self {
        Self { reader, folder: tempfile::tempdir().expect("a folder for files") }
    }

    /// Runs the reader on a file that contains `bytes`. The DICOM reader gets a folder of slices. A
    /// particle file is read a second time with a corrected length and checksum.
    ///
    /// # Panics
    /// Panics if the reader panics, or if its error lacks one of the three parts.
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
        // The reader uses only the folder of this path; the file need not exist.
        self.read(&self.folder.path().join(name));
        for (path, _) in &others {
            std::fs::remove_file(path).expect("a slice that is there");
        }
    }

    /// Runs the reader on a file called `name` that contains `bytes`.
    ///
    /// # Panics
    /// Panics in the same cases as [`Feeder::feed`].
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

/// Returns a copy of a particle file with the correct payload length and checksum in its header
/// (`particle_file.rs`), or `None` for other files. Random changes almost always invalidate both.
fn sealed(bytes: &[u8]) -> Option<Vec<u8>> {
    let (head, _) = bytes.split_at_checked(16).filter(|(head, _)| head.starts_with(b"ISOPART\n"))?;
    let payload = bytes.get(56..)?;
    Some([head, &(payload.len() as u64).to_le_bytes(), blake3::hash(payload).as_bytes(), payload].concat())
}

/// Length in bytes of the DICOM preamble, which precedes the letters DICM.
const SLICE_MAGIC: usize = 128;

/// Splits concatenated slices. Each slice starts 128 bytes before the letters DICM. The DICOM
/// reader needs at least two slices; with only one, it returns an error before it reads pixels.
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
