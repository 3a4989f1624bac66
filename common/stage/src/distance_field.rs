//! The implicit surface that later stages work on: the distance field of one object, or the
//! indicators of several materials. `distfield` writes either to the same kind of file.

use crate::error::Result;
use crate::field_file::{Field, FieldKind, read_field};
use crate::materials_file::{MaterialsFile, is_materials, read_materials};
use isoparticles_file::history::History;
use isoparticles_volume::{Geometry, Space};
use std::io::{self, Write};
use std::path::Path;
use std::sync::Arc;

/// The contents of a file that `distfield` wrote. Clones share the samples.
#[derive(Clone, Debug, PartialEq)]
pub enum DistanceField {
    /// Samples of F of one object, mm.
    Object(Field),
    /// The indicators of several materials.
    Materials(Arc<MaterialsFile>),
}

impl DistanceField {
    /// Reads a distance field, or the indicators of several materials.
    ///
    /// # Errors
    /// If the file cannot be read, or contains neither.
    pub fn read(path: &Path) -> Result<Self> {
        if is_materials(path) {
            return read_materials(path).map(|file| Self::Materials(Arc::new(file)));
        }
        read_field(path, FieldKind::Distance).map(Self::Object)
    }

    /// Returns the field with its grid in another anatomical frame ([`Geometry::in_space`]).
    #[must_use]
    pub fn in_space(self, space: Space) -> Self {
        if self.geometry().space == space {
            return self;
        }
        match self {
            Self::Object(field) => Self::Object(field.in_space(space)),
            Self::Materials(file) => {
                let file = Arc::unwrap_or_clone(file);
                Self::Materials(Arc::new(MaterialsFile { materials: file.materials.in_space(space), ..file }))
            }
        }
    }

    /// Returns the grid.
    pub fn geometry(&self) -> &Geometry {
        match self {
            Self::Object(field) => &field.image.geometry,
            Self::Materials(file) => file.materials.geometry(),
        }
    }

    /// Returns the history of the file, if it has one.
    pub fn history(&self) -> Option<&History> {
        match self {
            Self::Object(field) => field.history.as_ref(),
            Self::Materials(file) => file.history.as_ref(),
        }
    }

    /// Returns the names of the materials, starting with the outside; none for one object.
    pub fn material_names(&self) -> Vec<String> {
        match self {
            Self::Object(_) => Vec::new(),
            Self::Materials(file) => file.materials.names(),
        }
    }

    /// Returns whether there are several materials.
    pub fn is_materials(&self) -> bool {
        matches!(self, Self::Materials(_))
    }

    /// Writes the file.
    ///
    /// # Errors
    /// If the file cannot be written.
    ///
    /// # Panics
    /// If the materials come from [`DistanceField::read`], which omits the point data for display.
    pub fn write(&self, path: &Path) -> Result<()> {
        match self {
            Self::Object(field) => field.write(path),
            Self::Materials(file) => file.write(path),
        }
    }

    /// Writes the bytes of the file.
    ///
    /// # Errors
    /// If `file` returns an error.
    ///
    /// # Panics
    /// As for [`DistanceField::write`].
    pub fn encode(&self, file: &mut dyn Write) -> io::Result<()> {
        match self {
            Self::Object(field) => field.encode(file),
            Self::Materials(materials) => materials.encode(file),
        }
    }
}
