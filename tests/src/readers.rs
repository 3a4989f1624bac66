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

/// A folder of one slice.
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
    pub fn feed(&self, bytes: &[u8]) {
        self.feed_file(&format!("file.{}", self.ending), bytes);
    }

    /// The same with a name of the file's own.
    ///
    /// # Panics
    /// As [`Reader::feed`].
    pub fn feed_file(&self, name: &str, bytes: &[u8]) {
        let folder = tempfile::tempdir().expect("a folder for a file");
        let path = folder.path().join(name);
        std::fs::write(&path, bytes).expect("a file to read");
        if let Some(error) = (self.read)(&path) {
            assert!(
                !error.what.is_empty() && !error.why.is_empty() && !error.next.is_empty(),
                "{}: {error}",
                self.name
            );
        }
    }
}
