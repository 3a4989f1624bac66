//! The closed surfaces of single materials, taken from the interfaces between all of them.

use crate::interfaces::Interfaces;
use isoparticles_field::materials::{Material, MaterialId};
use isoparticles_mesh::quality::radius_ratios;
use isoparticles_mesh::surface::{DataArray, Surface};
use isoparticles_stage::meta::{self, Source, SurfaceMeta};
use isoparticles_volume::Geometry;
use serde_json::{Map, json};

/// The interfaces between materials in the grid frame, with the target edge length at each vertex.
pub(crate) struct MaterialSurfaces {
    interfaces: Interfaces,
    sizes: Vec<f64>,
    geometry: Geometry,
}

/// The closed surface of one material.
pub struct MaterialSurface<'a> {
    /// Number of the material.
    pub id: MaterialId,
    /// Name of the material.
    pub name: &'a str,
    /// The surface in world coordinates. Neighbouring surfaces have the same vertices on their
    /// common interface.
    pub surface: Surface,
    /// The metadata of the surface.
    pub meta: SurfaceMeta,
}

impl MaterialSurfaces {
    pub(crate) fn new(interfaces: Interfaces, sizes: Vec<f64>, geometry: Geometry) -> Self {
        Self { interfaces, sizes, geometry }
    }

    /// Returns the surface of each material of the table except the outside, one at a time.
    pub(crate) fn each<'a>(&'a self, table: &'a [Material]) -> impl Iterator<Item = MaterialSurface<'a>> {
        let ids = self.interfaces.materials().into_iter().filter(|id| *id != MaterialId::OUTSIDE);
        ids.map(|id| self.surface_of(id, &table[id.index()]))
    }

    fn surface_of<'a>(&self, id: MaterialId, material: &'a Material) -> MaterialSurface<'a> {
        let (mesh, vertices, triangles) = self.interfaces.surface_of(id);
        let mut surface = Surface::from_grid(&mesh, &self.geometry);
        let beyond = |&t: &u32| {
            let [inside, outside] = self.interfaces.between[t as usize];
            i64::from(if inside == id { outside.0 } else { inside.0 })
        };
        let sizes = vertices.iter().map(|&v| self.sizes[v as usize]).collect();
        let whole = vertices.iter().map(|&v| i64::from(v)).collect();
        surface.point_data = vec![DataArray::scalars("h", sizes), DataArray::integers("vertex", whole)];
        surface.cell_data = vec![
            DataArray::integers("material_outside", triangles.iter().map(beyond).collect()),
            DataArray::scalars("radius_ratio", radius_ratios(&mesh)),
        ];
        let meta = SurfaceMeta {
            version: meta::VERSION,
            source: Some(Source::Labels),
            notes: Map::from_iter([("material".to_owned(), json!(material))]),
            ..SurfaceMeta::default()
        };
        MaterialSurface { id, name: &material.name, surface, meta }
    }
}
