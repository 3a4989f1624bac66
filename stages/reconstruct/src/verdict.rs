//! Compares the finished mesh with the topology of F, which is computed without any mesh. At
//! undecided places of F, either of two topologies is accepted and listed. Elsewhere, any
//! difference fails the check.

use crate::defects::{Defects, Found};
use crate::object::component_at;
use glam::DVec3;
use isoparticles_field::spline::CubicSpline;
use isoparticles_field::topology::{FieldTopology, TopologySummary};
use isoparticles_mesh::TriangleMesh;
use isoparticles_stage::cli::values::place;
use isoparticles_volume::Geometry;
use rayon::prelude::*;
use serde::Serialize;

/// The topology of F, that of the mesh, and their differences.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct TopologyReport {
    /// Topology of F.
    pub field: TopologySummary,
    /// Number of components of the mesh.
    pub components: usize,
    /// Euler characteristic of the mesh.
    pub euler: i64,
    /// Number of triangles with vertices on different components of F = 0 that no undecided place
    /// can join.
    pub joining_triangles: usize,
    /// Components of F = 0 that the mesh lacks: a position near each of them, in world coordinates
    /// (mm).
    pub missing: Vec<[f64; 3]>,
    /// Number of components of the mesh that are near no component of F = 0, minus those that
    /// undecided specks allow.
    pub superfluous: usize,
    /// Groups of components for which the number of components or the Euler characteristic of the
    /// mesh is outside the range that F allows.
    pub wrong: Vec<Difference>,
}

/// A group of components whose topology in the mesh is not allowed by F.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Difference {
    /// A position near the first component of the group, in world coordinates (mm).
    pub place: [f64; 3],
    /// Topology of the mesh in this group.
    pub mesh: Found,
    /// Number of components of F = 0 in this group, and the minimum and maximum that the undecided
    /// places allow.
    pub components: [usize; 3],
    /// Euler characteristic of F = 0 in this group, with its minimum and maximum.
    pub euler: [i64; 3],
    /// Indices of the undecided places of this group in the list of [`TopologySummary`].
    pub undecided: Vec<u32>,
}

impl TopologyReport {
    /// Compares a mesh in the grid frame, with its vertices on F = 0, with the topology of F.
    pub fn new(mesh: &TriangleMesh, field: &CubicSpline, topology: &FieldTopology) -> Self {
        let component_of: Vec<u32> = mesh.vertices.par_iter().map(|&p| component_at(p, field, topology)).collect();
        // the checks report edges and vertices that are not manifold, so open edges are allowed
        // here
        let defects = Defects::find(&mesh.triangles, &component_of, topology, |_, _| true);
        let geometry = field.geometry();
        let missing = |&c: &u32| geometry.grid_to_world(topology.components()[c as usize].place).to_array();
        let difference = |found: &Found| Difference::new(*found, topology, geometry);
        let specks = topology.groups().all().iter().filter(|group| group.components.is_empty());
        let specks: usize = specks.map(|group| *group.component_count.end()).sum();
        Self {
            field: topology.summary(),
            components: defects.component_count,
            euler: defects.euler,
            joining_triangles: defects.bridges.len(),
            missing: defects.missing.iter().map(missing).collect(),
            superfluous: defects.strangers.saturating_sub(specks),
            wrong: defects.in_pieces.iter().chain(&defects.wrong_genus).map(difference).collect(),
        }
    }

    /// Returns the differences in words: those that fail the check, and those that only cause a
    /// warning. With an open border, a group in `wrong` fails only if the mesh has too many
    /// components, because the mesh may end slightly before or beyond the border of the volume.
    pub fn differences(&self, is_open: bool) -> (Vec<String>, Vec<String>) {
        let mut failed = Vec::new();
        if self.joining_triangles > 0 {
            failed.push(format!("{} triangles join different components of F = 0", self.joining_triangles));
        }
        if let Some(first) = self.missing.first() {
            let count = self.missing.len();
            failed.push(format!("{count} components of F = 0 are missing, the first at {} mm", place(*first)));
        }
        if self.superfluous > 0 {
            failed.push(format!("{} components do not exist in F = 0", self.superfluous));
        }
        let (wrong, open): (Vec<_>, Vec<_>) =
            self.wrong.iter().partition(|d| !is_open || d.mesh.components > d.components[2]);
        failed.extend(wrong.into_iter().map(Difference::told));
        (failed, open.into_iter().map(Difference::told).collect())
    }

    /// Returns the number of components of F and of undecided places, for the closing table.
    pub fn expected(&self) -> String {
        let count = self.field.components;
        match self.field.undecided.len() {
            0 => format!(" of {count}"),
            places => format!(" of {count}, {places} undecided"),
        }
    }
}

impl Difference {
    fn new(mesh: Found, topology: &FieldTopology, geometry: &Geometry) -> Self {
        let group = &topology.groups().all()[mesh.group as usize];
        let components = || group.components.iter().map(|&c| &topology.components()[c as usize]);
        let euler = components().map(|c| c.euler).sum();
        let place = components().next().map(|c| c.place);
        let speck = || group.undecided.first().map(|&n| DVec3::from_array(topology.undecided()[n as usize].place));
        Self {
            place: place.or_else(speck).map(|p| geometry.grid_to_world(p).to_array()).unwrap_or_default(),
            mesh,
            components: [group.components.len(), *group.component_count.start(), *group.component_count.end()],
            euler: [euler, *group.euler.start(), *group.euler.end()],
            undecided: group.undecided.clone(),
        }
    }

    fn told(&self) -> String {
        let range = |[own, least, most]: [i64; 3]| {
            if least == most { own.to_string() } else { format!("{own} ({least} to {most})") }
        };
        let by = match self.undecided.len() {
            0 => String::new(),
            count => format!(", by {count} undecided places"),
        };
        format!(
            "at {} mm: {} components with Euler characteristic {} where F = 0 has {} with {}{by}",
            place(self.place),
            self.mesh.components,
            self.mesh.euler,
            range(self.components.map(|n| n as i64)),
            range(self.euler),
        )
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scenes::{self, Scene};
    use glam::DVec3;
    use isoparticles_field::marching_cubes::marching_cubes;
    use isoparticles_field::topology::critical_points;

    fn report(mesh: &TriangleMesh, scene: &Scene) -> TopologyReport {
        TopologyReport::new(mesh, &scene.field, &FieldTopology::new(&scene.field))
    }

    #[test]
    fn only_meshes_with_wrong_topology_have_differences() {
        let scene = scenes::two_balls();
        let good = marching_cubes(&scene.image, 0.0);
        let right = report(&good, &scene);
        assert_eq!((right.components, right.euler, right.expected()), (2, 4, " of 2".to_owned()));
        assert_eq!(right.differences(false), (vec![], vec![]));

        let is_first = |mesh: &TriangleMesh, t: &[u32; 3]| mesh.vertices[t[0] as usize].x < 15.6;
        let mut lost = good.clone();
        lost.triangles.retain(|t| is_first(&good, t));
        let (failed, doubtful) = report(&lost, &scene).differences(false);
        assert!(failed.len() == 1 && failed[0].contains("1 components of F = 0 are missing"), "{failed:?}");
        assert!(doubtful.is_empty());

        // replaces one triangle of each ball by a tube between the balls
        let mut joined = good.clone();
        let facing = |first: bool| {
            let own = (0..good.triangles.len()).filter(|&t| is_first(&good, &good.triangles[t]) == first);
            let gap = |&t: &usize| (good.corners(t)[0].x - 15.6).abs();
            own.min_by(|a, b| gap(a).total_cmp(&gap(b))).expect("a triangle")
        };
        let [a, b] = [facing(true), facing(false)];
        let ([p, q, r], [u, v, w]) = (good.triangles[a], good.triangles[b]);
        joined.triangles.extend([[p, q, u], [q, w, u], [q, r, w], [r, v, w], [r, p, v], [p, u, v]]);
        joined.triangles.retain(|t| *t != good.triangles[a] && *t != good.triangles[b]);
        let (failed, _) = report(&joined, &scene).differences(false);
        assert!(failed[0].contains("6 triangles join different components"), "{failed:?}");

        // adds a third ball
        let mut more = good.clone();
        let count = more.vertices.len() as u32;
        let beside = good.vertices.iter().map(|&p| 0.1 * p + DVec3::new(0.0, 0.0, 0.5)).collect::<Vec<_>>();
        more.vertices.extend(beside);
        more.triangles.extend(lost.triangles.iter().map(|t| t.map(|v| v + count)));
        let (failed, _) = report(&more, &scene).differences(false);
        assert_eq!(failed, ["1 components do not exist in F = 0"]);

        let holed = report(&marching_cubes(&scenes::pierced().image, 0.0), &scenes::pierced());
        let (failed, _) = holed.differences(false);
        assert!(
            failed.len() == 1 && failed[0].contains("Euler characteristic 2 where F = 0 has 1 with 0"),
            "{failed:?}"
        );
        assert_eq!(holed.differences(true).0, Vec::<String>::new());
    }

    #[test]
    fn differences_at_undecided_places_do_not_fail() {
        let balls = |level: f64| {
            let [a, b] = [9.3, 21.8].map(|x| DVec3::new(x, 15.4, 15.6));
            Scene::new([32; 3], DVec3::ONE, |p| (p.distance(a) - 6.0).min(p.distance(b) - 6.0) - level)
        };
        let saddles = critical_points(&balls(0.0).field, 0.0);
        let far = |p: DVec3| p.distance(DVec3::new(15.55, 15.4, 15.6));
        let saddle = saddles.into_iter().min_by(|a, b| far(a.position).total_cmp(&far(b.position))).expect("a saddle");
        let scene = balls(saddle.value);
        let [apart, together] = [-0.2f32, 0.2].map(|iso| report(&marching_cubes(&scene.image, iso), &scene));
        assert_eq!(([apart.components, together.components], [apart.euler, together.euler]), ([2, 1], [4, 2]));
        for found in [&apart, &together] {
            assert_eq!(found.differences(false).0, Vec::<String>::new());
            assert_eq!(found.field.components_between, [1, 2]);
            assert!(found.expected().ends_with(", 1 undecided"), "{}", found.expected());
        }
        // the sign at the saddle determines the topology, but the gap is too small for a mesh
        let scene = balls(saddle.value - 3e-4);
        let [apart, together] = [-0.2f32, 0.2].map(|iso| report(&marching_cubes(&scene.image, iso), &scene));
        assert_eq!(([apart.components, together.components], [apart.euler, together.euler]), ([2, 1], [4, 2]));
        for found in [&apart, &together] {
            assert_eq!((found.field.components, found.field.undecided.len()), (2, 1));
            assert_eq!(found.differences(false).0, Vec::<String>::new());
        }
    }
}
