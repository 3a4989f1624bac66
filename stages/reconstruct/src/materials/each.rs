//! The closed surfaces of single materials, taken from the surface of all interfaces.

use crate::interfaces::Interfaces;
use isoparticles_field::materials::{Material, MaterialId};
use isoparticles_mesh::surface::{DataArray, Surface};
use isoparticles_stage::meta::{self, Source, SurfaceMeta};
use serde_json::{Map, json};

/// Names of the triangle arrays with the materials inside and outside.
pub(crate) const SIDES: [&str; 2] = ["material_inside", "material_outside"];

/// A surface of all interfaces between materials, as `reconstruct` makes it.
pub struct MaterialSurfaces<'a> {
    whole: &'a Surface,
    interfaces: Interfaces,
    table: &'a [Material],
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

impl<'a> MaterialSurfaces<'a> {
    /// Reads the materials of the triangles of `whole`. `table` contains the names. Returns `None`
    /// if the triangles have no materials.
    pub fn new(whole: &'a Surface, table: &'a [Material]) -> Option<Self> {
        let [inside, outside] = SIDES.map(|name| Some(find(&whole.cell_data, name)?.values.to_f64()));
        let sides = inside?.into_iter().zip(outside?);
        let between = sides.map(|(inside, outside)| [inside, outside].map(|id| MaterialId(id as u16))).collect();
        let interfaces = Interfaces { mesh: whole.mesh.clone(), between, ..Interfaces::default() };
        Some(Self { whole, interfaces, table })
    }

    /// Returns the surface of each material except the outside, one at a time.
    pub fn each(self) -> impl Iterator<Item = MaterialSurface<'a>> {
        let ids = self.interfaces.regions().into_iter().filter(|id| *id != MaterialId::OUTSIDE);
        ids.filter_map(move |id| self.surface_of(id))
    }

    /// Returns the surface of a material. Returns `None` if the material is not in the table.
    pub fn surface_of(&self, id: MaterialId) -> Option<MaterialSurface<'a>> {
        let material = self.table.get(id.index())?;
        let (mesh, vertices, triangles) = self.interfaces.surface_of(id);
        let beyond = |&t: &u32| {
            let [inside, outside] = self.interfaces.between[t as usize];
            i64::from(if inside == id { outside.0 } else { inside.0 })
        };
        let mut point_data = rows(&self.whole.point_data, "h", &vertices);
        point_data.push(DataArray::integers("vertex", vertices.iter().map(|&v| i64::from(v)).collect()));
        let mut cell_data = vec![DataArray::integers(SIDES[1], triangles.iter().map(beyond).collect())];
        cell_data.extend(rows(&self.whole.cell_data, "radius_ratio", &triangles));
        let meta = SurfaceMeta {
            version: meta::VERSION,
            source: Some(Source::Labels),
            notes: Map::from_iter([("material".to_owned(), json!(material))]),
            ..SurfaceMeta::default()
        };
        let surface = Surface { mesh, point_data, cell_data, space: self.whole.space };
        Some(MaterialSurface { id, name: &material.name, surface, meta })
    }
}

fn find<'a>(arrays: &'a [DataArray], name: &str) -> Option<&'a DataArray> {
    arrays.iter().find(|array| array.name == name)
}

/// Returns some values of the array with this name, if there is one.
fn rows(arrays: &[DataArray], name: &str, rows: &[u32]) -> Vec<DataArray> {
    let values = find(arrays, name).map(|array| array.values.to_f64());
    let own = values.map(|values| rows.iter().map(|&row| values[row as usize]).collect());
    own.map(|own| DataArray::scalars(name, own)).into_iter().collect()
}
