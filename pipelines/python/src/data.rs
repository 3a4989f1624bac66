//! The values that the stages exchange, as one Python class.

use crate::errors::raised;
use crate::pool;
use isoparticles_field::materials::{Material, MaterialId};
use isoparticles_mesh::surface::{
    DataArray, Simplices, Surface, SurfaceFile, encode_surface, read_surface, write_simplices, write_surface,
};
use isoparticles_reconstruct::run::MaterialSurfaces;
use isoparticles_reconstruct::update::Reference;
use isoparticles_stage::cli::{Context, Listener};
use isoparticles_stage::distance_field::DistanceField;
use isoparticles_stage::error::{Error, Result};
use isoparticles_stage::field_file::{Field, FieldKind, read_field};
use isoparticles_stage::history::{History, file_name, hash_file, hash_written};
use isoparticles_stage::materials_file::{KIND, kind_of, read_materials_with_shown};
use isoparticles_stage::meta::{SurfaceMeta, typed};
use isoparticles_stage::particle_file::{MAGIC, ParticleFile, ParticleKind, read_particles};
use isoparticles_volume::{Endian, Geometry};
use pyo3::exceptions::PyKeyError;
use pyo3::prelude::*;
use pyo3::types::PyBytes;
use serde_json::{Value as Json, json};
use std::io::Read;
use std::path::{Path, PathBuf};
use std::sync::{Arc, OnceLock};

/// A value, and the data that histories record about its file.
pub(crate) struct Kept {
    pub(crate) value: Value,
    /// File name in histories.
    name: String,
    /// Hash of the file, computed when a history needs it.
    hash: OnceLock<String>,
    /// What updates of surfaces derive from this distance field.
    reference: OnceLock<Arc<Reference>>,
}

/// The result of a stage.
pub(crate) enum Value {
    /// Result of `distfield`.
    Distance(DistanceField),
    /// Result of `sizefield`.
    Size(Field),
    /// Result of `seed` or `particles`.
    Particles(ParticleFile),
    /// Result of `reconstruct`, or the surface of one material.
    Surface {
        file: SurfaceFile,
        /// Simplices of the failed checks, unless the surface comes from a file.
        offending: Option<Simplices>,
    },
}

impl Kept {
    pub(crate) fn new(value: Value, name: String) -> Self {
        Self { value, name, hash: OnceLock::new(), reference: OnceLock::new() }
    }

    /// Records this value as an input of a run.
    pub(crate) fn record(&self, context: &Context) -> Result<()> {
        context.add_value(self.name.clone(), self.hash()?, self.history().cloned());
        Ok(())
    }

    /// Returns the distance field or the materials.
    pub(crate) fn distance(&self) -> Result<&DistanceField> {
        if let Value::Distance(distance) = &self.value { Ok(distance) } else { Err(self.is_not("a distance field")) }
    }

    /// Returns what updates of surfaces derive from the distance field.
    pub(crate) fn reference(&self, context: &Context) -> Result<Arc<Reference>> {
        if let Some(reference) = self.reference.get() {
            return Ok(Arc::clone(reference));
        }
        let reference = Arc::new(Reference::new(self.distance()?, context)?);
        Ok(Arc::clone(self.reference.get_or_init(|| reference)))
    }

    /// Returns the size field.
    pub(crate) fn sizing(&self) -> Result<&Field> {
        if let Value::Size(field) = &self.value { Ok(field) } else { Err(self.is_not("a size field")) }
    }

    /// Returns the particles.
    pub(crate) fn particles(&self) -> Result<&ParticleFile> {
        if let Value::Particles(file) = &self.value { Ok(file) } else { Err(self.is_not("particles")) }
    }

    fn is_not(&self, needed: &str) -> Error {
        Error::of_file(Path::new(&self.name), format!("is not {needed}"), "the stage needs it", "pass another value")
    }

    /// Returns the hash that the file of this value has or would have.
    pub(crate) fn hash(&self) -> Result<String> {
        if let Some(hash) = self.hash.get() {
            return Ok(hash.clone());
        }
        let hash = match &self.value {
            Value::Distance(distance) => hash_written(|file| distance.encode(file)),
            Value::Size(field) => hash_written(|file| field.encode(file)),
            Value::Particles(particles) => hash_written(|file| particles.encode(file)),
            Value::Surface { file, .. } => match &file.history {
                Some(history) => hash_written(|out| encode_surface(out, &file.surface, &file.meta, history)),
                None => Err(std::io::Error::other("no stage has made it")),
            },
        };
        let hash = hash.map_err(|error| Error::file(Path::new(&self.name), "hash", &error, "report this bug"))?;
        Ok(self.hash.get_or_init(|| hash).clone())
    }

    fn history(&self) -> Option<&History> {
        match &self.value {
            Value::Distance(distance) => distance.history(),
            Value::Size(field) => field.history.as_ref(),
            Value::Particles(particles) => Some(&particles.history),
            Value::Surface { file, .. } => file.history.as_ref(),
        }
    }

    fn meta(&self) -> &Json {
        match &self.value {
            Value::Distance(DistanceField::Object(field)) | Value::Size(field) => &field.meta,
            Value::Distance(DistanceField::Materials(file)) => &file.meta,
            Value::Particles(particles) => &particles.meta,
            Value::Surface { file, .. } => &file.meta,
        }
    }

    fn geometry(&self) -> Option<&Geometry> {
        match &self.value {
            Value::Distance(distance) => Some(distance.geometry()),
            Value::Size(field) => Some(&field.image.geometry),
            Value::Particles(file) => Some(&file.particles.geometry),
            Value::Surface { .. } => None,
        }
    }

    /// Returns the surface with its metadata and history.
    pub(crate) fn surface_file(&self) -> Result<&SurfaceFile> {
        if let Value::Surface { file, .. } = &self.value { Ok(file) } else { Err(self.is_not("a surface")) }
    }

    fn surface(&self) -> Option<&Surface> {
        if let Value::Surface { file, .. } = &self.value { Some(&file.surface) } else { None }
    }

    /// Returns the table of the materials of a surface.
    fn table(&self) -> Vec<Material> {
        typed::<SurfaceMeta>(Path::new(&self.name), self.meta(), "reconstruct").unwrap_or_default().materials
    }

    fn write(&self, path: &Path) -> Result<()> {
        match &self.value {
            Value::Distance(distance) => distance.write(path),
            Value::Size(field) => field.write(path),
            Value::Particles(particles) => particles.write(path),
            Value::Surface { file, offending } => {
                let history = file.history.as_ref().ok_or_else(|| {
                    Error::of_file(path, "this surface has no history", "no stage has made it", "save it with PyVista")
                })?;
                write_surface(path, &file.surface, &file.meta, history)?;
                let beside = path.with_extension("offending.vtp");
                Ok(offending.iter().try_for_each(|simplices| write_simplices(&beside, simplices, history))?)
            }
        }
    }
}

/// The result of a stage, immutable.
#[pyclass(frozen, module = "isoparticles._native")]
pub(crate) struct Data(pub(crate) Arc<Kept>);

/// Type, shape and bytes of an array, as `numpy.frombuffer` reads them.
type Array<'py> = (&'static str, Vec<usize>, Bound<'py, PyBytes>);

/// Size, spacing (mm), origin (mm) and axes (one row per axis) of a grid.
type Grid = ([usize; 3], [f64; 3], [f64; 3], [[f64; 3]; 3]);

#[pymethods]
impl Data {
    /// Name of the file kind.
    #[getter]
    fn kind(&self) -> &'static str {
        match &self.0.value {
            Value::Distance(DistanceField::Object(field)) | Value::Size(field) => field.kind.name(),
            Value::Distance(DistanceField::Materials(_)) => KIND,
            Value::Particles(particles) => particles.kind.name(),
            Value::Surface { .. } => "surface",
        }
    }

    /// File name in histories.
    #[getter]
    fn name(&self) -> &str {
        &self.0.name
    }

    /// Metadata as JSON.
    #[getter]
    fn meta(&self) -> String {
        self.0.meta().to_string()
    }

    /// History as JSON.
    #[getter]
    fn history(&self) -> String {
        json!(self.0.history()).to_string()
    }

    /// Names of the materials, starting with the outside; empty for one object.
    #[getter]
    fn materials(&self) -> Vec<String> {
        match &self.0.value {
            Value::Distance(distance) => distance.material_names(),
            Value::Surface { .. } => self.0.table().into_iter().map(|material| material.name).collect(),
            _ => Vec::new(),
        }
    }

    /// The world frame: `lps`, `ras`, or none if it is not anatomical.
    #[getter]
    fn space(&self) -> Option<String> {
        let of_grid = || self.0.geometry().map(|geometry| geometry.space);
        let space = self.0.surface().map(|surface| surface.space).or_else(of_grid)?;
        space.name().map(str::to_lowercase)
    }

    /// The grid, unless this is a surface.
    #[getter]
    fn grid(&self) -> Option<Grid> {
        let geometry = self.0.geometry()?;
        let (spacing, origin) = (geometry.spacing.to_array(), geometry.origin.to_array());
        Some((geometry.size, spacing, origin, geometry.directions.to_cols_array_2d()))
    }

    /// Names of the point arrays and of the cell arrays of a surface.
    #[getter]
    fn array_names(&self) -> (Vec<String>, Vec<String>) {
        let of = |arrays: &[DataArray]| arrays.iter().map(|array| array.name.clone()).collect();
        self.0.surface().map_or_else(Default::default, |surface| (of(&surface.point_data), of(&surface.cell_data)))
    }

    /// Copies an array: of a field, in Fortran order; of particles or of a surface, one row each.
    /// Positions are world coordinates in mm.
    fn array<'py>(&self, py: Python<'py>, name: &str) -> PyResult<Array<'py>> {
        let of_grid = |dtype, size: [usize; 3], bytes: &[u8]| (dtype, size.to_vec(), PyBytes::new(py, bytes));
        match &self.0.value {
            Value::Distance(DistanceField::Object(field)) | Value::Size(field) if name == field.kind.array_name() => {
                Ok(of_grid("float32", field.image.geometry.size, bytemuck::cast_slice(&field.image.data)))
            }
            Value::Distance(DistanceField::Materials(file)) if name == "material" => {
                Ok(of_grid("uint16", file.materials.geometry().size, bytemuck::cast_slice(&file.shown.material)))
            }
            Value::Distance(DistanceField::Materials(file)) if name == "interface_distance" => Ok(of_grid(
                "float32",
                file.materials.geometry().size,
                bytemuck::cast_slice(&file.shown.interface_distance),
            )),
            Value::Particles(file) => of_particles(py, file, name),
            Value::Surface { file, .. } => of_surface(py, &file.surface, name),
            _ => Err(PyKeyError::new_err(name.to_owned())),
        }
    }

    /// Writes the file, and replaces an existing file.
    fn write(&self, py: Python<'_>, path: PathBuf) -> PyResult<()> {
        let kept = Arc::clone(&self.0);
        pool::run(py, 0, &Arc::new(Listener::default()), None, move || kept.write(&path))?
            .map_err(|error| raised(py, error))
    }

    /// Returns the closed surface of a material.
    fn of_material(&self, py: Python<'_>, name: String) -> PyResult<Self> {
        let (kept, wanted) = (Arc::clone(&self.0), name.clone());
        let found = pool::run(py, 0, &Arc::new(Listener::default()), None, move || {
            let table = kept.table();
            let id = table.iter().position(|material| material.name == wanted)?;
            let own = MaterialSurfaces::new(kept.surface()?, &table)?.surface_of(MaterialId(id as u16))?;
            Some(SurfaceFile { surface: own.surface, meta: json!(own.meta), history: kept.history().cloned() })
        })?;
        let file = found.ok_or_else(|| PyKeyError::new_err(name))?;
        Ok(Self(Arc::new(Kept::new(Value::Surface { file, offending: None }, self.0.name.clone()))))
    }
}

fn of_particles<'py>(py: Python<'py>, file: &ParticleFile, name: &str) -> PyResult<Array<'py>> {
    let (set, geometry) = (&file.particles, &file.particles.geometry);
    let count = set.positions.len();
    let rows = |points: Vec<[f64; 3]>| ("float64", vec![count, 3], PyBytes::new(py, bytemuck::cast_slice(&points)));
    let column = |values: &[f64]| ("float64", vec![count], PyBytes::new(py, bytemuck::cast_slice(values)));
    match name {
        "positions" => Ok(rows(set.positions.iter().map(|&p| geometry.grid_to_world(p).to_array()).collect())),
        "normals" => Ok(rows(set.normals.iter().map(|&n| geometry.normal_to_world(n).to_array()).collect())),
        "sizes" => Ok(column(&set.sizes)),
        "energies" => Ok(column(&set.energies)),
        _ => Err(PyKeyError::new_err(name.to_owned())),
    }
}

fn of_surface<'py>(py: Python<'py>, surface: &Surface, name: &str) -> PyResult<Array<'py>> {
    let mesh = &surface.mesh;
    match name {
        "vertices" => {
            let points: Vec<[f64; 3]> = mesh.vertices.iter().map(|vertex| vertex.to_array()).collect();
            return Ok(("float64", vec![points.len(), 3], PyBytes::new(py, bytemuck::cast_slice(&points))));
        }
        "triangles" => {
            let corners: Vec<i64> = mesh.triangles.as_flattened().iter().map(|&corner| i64::from(corner)).collect();
            return Ok(("int64", vec![mesh.triangles.len(), 3], PyBytes::new(py, bytemuck::cast_slice(&corners))));
        }
        _ => {}
    }
    let arrays = match name.split_once(':') {
        Some(("point", _)) => &surface.point_data,
        _ => &surface.cell_data,
    };
    let own = name.split_once(':').map_or(name, |(_, own)| own);
    let array = arrays.iter().find(|array| array.name == own).ok_or_else(|| PyKeyError::new_err(name.to_owned()))?;
    let shape = if array.components == 1 { vec![array.tuples()] } else { vec![array.tuples(), array.components] };
    let length = 8 * array.values.len();
    let bytes = PyBytes::new_with_writer(py, length, |bytes| Ok(array.values.write_to(bytes, Endian::Little)?))?;
    Ok((array.values.type_name(), shape, bytes))
}

/// Reads a file that a stage has written.
#[pyfunction]
pub(crate) fn load(py: Python<'_>, path: PathBuf) -> PyResult<Data> {
    let kept = pool::run(py, 0, &Arc::new(Listener::default()), None, move || read(&path))?;
    Ok(Data(Arc::new(kept.map_err(|error| raised(py, error))?)))
}

fn read(path: &Path) -> Result<Kept> {
    let kept = Kept::new(read_value(path)?, file_name(path));
    // the file may have been edited and saved by another program
    let hash = hash_file(path)?;
    kept.hash.get_or_init(|| hash);
    Ok(kept)
}

fn read_value(path: &Path) -> Result<Value> {
    let cannot = |error| Error::file(path, "read", &error, "check the name of the file");
    let mut start = Vec::new();
    std::fs::File::open(path).and_then(|file| file.take(8).read_to_end(&mut start)).map_err(cannot)?;
    if start == MAGIC {
        return read_particles(path, &[ParticleKind::Particles, ParticleKind::Seeds]).map(Value::Particles);
    }
    if path.extension().is_some_and(|ending| ending.eq_ignore_ascii_case("vtp")) {
        return Ok(Value::Surface { file: read_surface(path)?, offending: None });
    }
    match kind_of(path)?.as_deref() {
        Some(KIND) => {
            read_materials_with_shown(path).map(|file| Value::Distance(DistanceField::Materials(Arc::new(file))))
        }
        Some("sizefield") => read_field(path, FieldKind::Sizing).map(Value::Size),
        _ => read_field(path, FieldKind::Distance).map(|field| Value::Distance(DistanceField::Object(field))),
    }
}
