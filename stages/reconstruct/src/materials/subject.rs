//! Many materials as the reference of the improvement and of the checks. The function of the
//! interface between materials i and j is G_ij, half the difference of their indicators.

use super::nodes::Nodes;
use super::pieces::{describe_euler, missing, pieces};
use crate::check::report::CheckReport;
use crate::improve::InterfaceFunctions;
use crate::interfaces::{Interface, Interfaces};
use crate::subject::{Comparison, Subject, Topology};
use glam::DVec3;
use isoparticles_field::materials::{Indicators, Material, MaterialId, Stratum};
use isoparticles_field::spline::Jet;
use isoparticles_mesh::TriangleMesh;
use isoparticles_volume::Geometry;

/// Many materials.
pub struct Materials<'a> {
    /// Their indicators.
    pub indicators: &'a dyn Indicators,
    /// The material of each grid node.
    pub nodes: &'a Nodes,
    /// Their names, followed by those of the planes at which they end.
    pub table: &'a [Material],
}

impl Subject for Materials<'_> {
    fn geometry(&self) -> &Geometry {
        self.nodes.geometry()
    }

    fn functions(&self) -> &dyn InterfaceFunctions {
        self
    }

    fn table(&self) -> &[Material] {
        self.table
    }

    fn first_beyond(&self) -> Option<MaterialId> {
        self.indicators.first_beyond()
    }

    fn wrong_nodes(&self, interfaces: &Interfaces) -> Option<Vec<usize>> {
        Some(self.nodes.wrong_by(interfaces))
    }

    fn compare(&self, _mesh: &TriangleMesh, checked: &CheckReport) -> Comparison {
        let real = self.indicators.first_beyond().map_or(self.table.len(), MaterialId::index);
        let pieces = pieces(self.nodes, checked, &self.table[..real]);
        let failed = missing(&pieces).into_iter().collect();
        let doubtful = describe_euler(&pieces).into_iter().collect();
        Comparison { topology: Topology::Materials(pieces), failed, doubtful }
    }
}

impl InterfaceFunctions for Materials<'_> {
    fn value(&self, pair: Interface, p: DVec3) -> f64 {
        self.value_gradient(pair, p).0
    }

    fn value_gradient(&self, [i, j]: Interface, p: DVec3) -> (f64, DVec3) {
        self.indicators.difference_gradient(i, j, p)
    }

    fn jet(&self, [i, j]: Interface, p: DVec3) -> Jet {
        self.indicators.difference(i, j, p)
    }

    fn project(&self, pair: Interface, start: DVec3, limit: f64, tolerance: f64) -> Option<(DVec3, DVec3)> {
        let p = self.indicators.project_onto_interface(pair, start, limit, tolerance)?;
        (self.indicators.clearance(p, &pair) > 0.0).then(|| (p, self.value_gradient(pair, p).1))
    }

    fn project_onto_curve(
        &self,
        interfaces: [Interface; 2],
        start: DVec3,
        limit: f64,
        tolerance: f64,
    ) -> Option<DVec3> {
        let [first, second] = interfaces.map(|[i, j]| Stratum::interface(i, j));
        let curve = first.joined(&second)?;
        let own = <[MaterialId; 3]>::try_from(curve.materials()).ok()?;
        let place = self.indicators.project_onto_curve(own, start, limit, tolerance)?;
        (self.indicators.clearance(place, &own) > 0.0).then_some(place)
    }

    fn region(&self, id: MaterialId) -> MaterialId {
        self.indicators.region(id)
    }

    fn voxel(&self) -> f64 {
        self.indicators.voxel()
    }
}
