//! Counts the connected components of each material, of grid nodes that share a face, and finds the
//! components that are missing from a mesh.

use super::nodes::Nodes;
use isoparticles_field::materials::Material;
use isoparticles_mesh::components::DisjointSets;
use serde::Serialize;
use std::collections::BTreeMap;

/// Maximum number of nodes of a component that may be missing. A mesh of edge length h does not
/// resolve such a speck.
pub const SMALL: usize = 8;

/// The components of a material.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct Pieces {
    /// Name of the material.
    pub name: String,
    /// Number of its grid nodes.
    pub nodes: usize,
    /// Number of components of nodes that share a face.
    pub components: usize,
    /// Numbers of nodes of the missing components of more than [`SMALL`] nodes. A component is
    /// missing if all its nodes lie in other materials of the mesh.
    pub missing: Vec<usize>,
    /// Number of missing components of at most [`SMALL`] nodes.
    pub missing_specks: usize,
}

/// Counts the components of each material of a table, and those that are missing from a mesh.
/// `wrong` contains the nodes (ascending) that lie in another material of the mesh.
pub fn pieces(nodes: &Nodes, wrong: &[usize], table: &[Material]) -> Vec<Pieces> {
    let truth = nodes.materials();
    let [nx, ny, _] = nodes.geometry().size;
    let plane = nx * ny;
    let mut sets = DisjointSets::new(truth.len());
    for n in 0..truth.len() {
        if n % nx > 0 && truth[n - 1] == truth[n] {
            sets.join(n as u32, n as u32 - 1);
        }
        if n % plane >= nx && truth[n - nx] == truth[n] {
            sets.join(n as u32, (n - nx) as u32);
        }
        if n >= plane && truth[n - plane] == truth[n] {
            sets.join(n as u32, (n - plane) as u32);
        }
    }
    // number of nodes of each component, and whether the mesh has one of them in its material
    let mut components: BTreeMap<u32, (usize, bool)> = BTreeMap::new();
    let mut wrong = wrong.iter().peekable();
    for n in 0..truth.len() {
        let own = components.entry(sets.find(n as u32)).or_default();
        own.0 += 1;
        own.1 |= wrong.next_if_eq(&&n).is_none();
    }
    let mut pieces: Vec<Pieces> =
        table.iter().map(|material| Pieces { name: material.name.clone(), ..Pieces::default() }).collect();
    for (root, (count, is_present)) in components {
        let Some(own) = pieces.get_mut(usize::from(truth[root as usize])) else { continue };
        own.nodes += count;
        own.components += 1;
        match (is_present, count > SMALL) {
            (true, _) => {}
            (false, true) => own.missing.push(count),
            (false, false) => own.missing_specks += 1,
        }
    }
    pieces
}

/// Describes the missing components, if there are any.
pub fn missing(pieces: &[Pieces]) -> Option<String> {
    let count: usize = pieces.iter().map(|own| own.missing.len()).sum();
    (count > 0).then(|| format!("{count} missing components of materials"))
}
