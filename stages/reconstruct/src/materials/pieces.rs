//! Finds the components of materials (grid nodes connected by faces) that are missing from a mesh.
//! Compares the Euler characteristics of the materials.

use super::nodes::Nodes;
use crate::check::report::{CheckReport, Fault, Simplices};
use isoparticles_field::materials::{Material, MaterialId};
use isoparticles_mesh::components::DisjointSets;
use serde::Serialize;
use std::collections::BTreeMap;

/// Maximum number of nodes of a component that may be missing. A mesh of edge length h does not
/// resolve such a speck.
pub const SMALL: usize = 8;

/// Maximum number of materials that a message names.
const NAMED: usize = 5;

/// The components and the Euler characteristic of a material.
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
    /// Euler characteristic of the surface of the material in the mesh; `None` if the mesh has no
    /// surface of this material, or if it is the outside of a single interface.
    pub mesh_euler: Option<i64>,
    /// The two results for that surface from the indicators, on a lattice of half voxels
    /// ([`isoparticles_field::materials::EulerPair`]), the smaller first.
    pub euler: [i64; 2],
    /// Number of cubes of the lattice at which the two results differ.
    pub undecided: usize,
}

impl Pieces {
    /// Returns whether the Euler characteristic in the mesh lies beyond both results.
    pub fn euler_differs(&self) -> bool {
        self.mesh_euler.is_some_and(|euler| euler < self.euler[0] || euler > self.euler[1])
    }
}

/// Compares each material of a table with its surface in a mesh. `checked` is the check of this
/// mesh.
pub fn pieces(nodes: &Nodes, checked: &CheckReport, table: &[Material]) -> Vec<Pieces> {
    let wrong = match checked.offenders.get(&Fault::NodesOnWrongSide) {
        Some(Simplices::Nodes(wrong)) => &wrong[..],
        _ => &[],
    };
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
    let of_indicators = |(id, material): (usize, &Material)| {
        let pair = nodes.euler.get(&MaterialId(id as u16)).copied().unwrap_or_default();
        let mesh_euler = checked.regions.iter().find(|own| own.name == material.name).map(|own| own.euler);
        let (euler, undecided) = (pair.ascending(), pair.undecided);
        Pieces { name: material.name.clone(), mesh_euler, euler, undecided, ..Pieces::default() }
    };
    let mut pieces: Vec<Pieces> = table.iter().enumerate().map(of_indicators).collect();
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

/// Names the materials of another Euler characteristic ([`Pieces::euler_differs`]), if there are
/// any.
pub fn describe_euler(pieces: &[Pieces]) -> Option<String> {
    let other: Vec<&Pieces> = pieces.iter().filter(|own| own.euler_differs()).collect();
    let told = |own: &&Pieces| {
        let [low, high] = own.euler;
        let expected = if low == high { low.to_string() } else { format!("{low} to {high}") };
        format!("{} {} instead of {expected}", own.name, own.mesh_euler.unwrap_or_default())
    };
    let named: Vec<String> = other.iter().take(NAMED).map(told).collect();
    let more = if other.len() > NAMED { ", ..." } else { "" };
    (!other.is_empty()).then(|| format!(
        "the Euler characteristic of {} of {} materials differs from that of the field (other handles, cavities or specks): {}{more}",
        other.len(), pieces.iter().filter(|own| own.mesh_euler.is_some()).count(), named.join(", ")
    ))
}
