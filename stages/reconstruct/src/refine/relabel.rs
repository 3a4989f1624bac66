//! Changes the sides of tetrahedra where points do not help. This separates parts of the surface
//! that touch, and removes small pieces of the mesh that correspond to no component of F = 0.

use super::Refinement;
use crate::defects::{Defects, edge_of};
use crate::restricted::Facet;
use isoparticles_mesh::components::NO_COMPONENT;
use rayon::prelude::*;
use std::cmp::Reverse;
use std::collections::{BTreeMap, HashSet};

/// Maximum number of rounds in which tetrahedra change sides where parts of the surface touch. In
/// the second half of the rounds, they only change from outside to inside, to prevent oscillation.
const PARTINGS: usize = 16;

/// Maximum number of vertices of a piece of the mesh that is removed, and of tetrahedra inside it.
const LARGEST_DROPPED: usize = 16;
const DROPPED_TETRAHEDRA: usize = 64;

impl Refinement<'_> {
    /// Separates parts of the surface that touch at edges or, if no edge can be separated, at
    /// vertices. Returns the number of edges or vertices.
    pub(super) fn part_pinches(&mut self, facets: &[Facet], defects: &Defects) -> usize {
        if defects.is_manifold() || self.partings >= PARTINGS {
            return 0;
        }
        let may_leave = 2 * self.partings < PARTINGS;
        let restricted = &mut self.object.restricted;
        let mut parted = 0;
        for around in &defects.edges {
            if let Some(edge) = edge_of(facets, around) {
                let start = facets[around[0] as usize].tetrahedron;
                parted += usize::from(restricted.part_edge(edge, start, may_leave));
            }
        }
        if parted == 0 {
            let vertices = defects.vertices.iter().map(|(v, _)| *v);
            parted = vertices.filter(|&v| restricted.part_vertex(v, may_leave)).count();
        }
        self.partings += usize::from(parted > 0);
        self.report.parted_pinches += parted;
        parted
    }

    /// Removes small pieces of the mesh that correspond to no component of F = 0: their tetrahedra
    /// change sides. Such a piece is near no component, or is not the largest piece of a group with
    /// too many pieces. One of its facets lies across F = 0, and no extremum of F belongs to it;
    /// every closed surface F = 0 encloses an extremum. Returns the number of pieces.
    pub(super) fn drop_pieces(&mut self, facets: &[Facet], defects: &Defects) -> usize {
        if defects.in_pieces.is_empty() && defects.strangers == 0 {
            return 0;
        }
        let piece = |f: &Facet| defects.piece_of_vertex[f.vertices[0] as usize];
        let across: HashSet<u32> = facets.par_iter().filter(|f| self.object.is_across(f)).map(piece).collect();
        let mut enclosed = Vec::new();
        for own in
            self.smaller_pieces(defects).chain(self.strange_pieces(defects)).filter(|own| own.len() <= LARGEST_DROPPED)
        {
            let number = defects.piece_of_vertex[own[0] as usize];
            if across.contains(&number) && !self.holds_extremum(&own) {
                let shell: Vec<Facet> = facets.iter().copied().filter(|f| piece(f) == number).collect();
                enclosed.extend(self.object.restricted.enclosed(&shell, DROPPED_TETRAHEDRA));
            }
        }
        enclosed.iter().for_each(|tetrahedra| self.object.restricted.change_sides(tetrahedra));
        self.report.dropped_pieces += enclosed.len();
        enclosed.len()
    }

    /// Returns the vertices, ascending, of each piece except the largest of each group with too
    /// many pieces.
    fn smaller_pieces(&self, defects: &Defects) -> impl Iterator<Item = Vec<u32>> + use<> {
        let groups = self.object.topology.groups();
        let mut pieces: BTreeMap<u32, BTreeMap<u32, Vec<u32>>> =
            defects.in_pieces.iter().map(|found| (found.group, BTreeMap::new())).collect();
        if !pieces.is_empty() {
            for (v, (&component, &piece)) in (0..).zip(self.object.component_of.iter().zip(&defects.piece_of_vertex)) {
                let of_group = groups.of(component).and_then(|group| pieces.get_mut(&group));
                if let Some(of_group) = of_group.filter(|_| piece != NO_COMPONENT) {
                    of_group.entry(piece).or_default().push(v);
                }
            }
        }
        pieces.into_values().flat_map(|of_group| {
            let mut of_group: Vec<Vec<u32>> = of_group.into_values().collect();
            of_group.sort_by_key(|vertices| Reverse(vertices.len()));
            of_group.into_iter().skip(1)
        })
    }

    /// Returns the vertices, ascending, of each piece of the mesh that is near no component of
    /// F = 0.
    fn strange_pieces(&self, defects: &Defects) -> Vec<Vec<u32>> {
        let mut pieces: BTreeMap<u32, Vec<u32>> = BTreeMap::new();
        if defects.strangers > 0 {
            let mut is_known = vec![false; defects.component_count];
            let used = || (0..).zip(&defects.piece_of_vertex).filter(|(_, piece)| **piece != NO_COMPONENT);
            let component_of = &self.object.component_of;
            used().for_each(|(v, &piece)| is_known[piece as usize] |= component_of[v as usize] != NO_COMPONENT);
            for (v, &piece) in used().filter(|(_, piece)| !is_known[**piece as usize]) {
                pieces.entry(piece).or_default().push(v as u32);
            }
        }
        pieces.into_values().collect()
    }
}
