//! The reference of the improvement and of the checks: the field of one object, or the indicators
//! of many materials.

use crate::check::report::CheckReport;
use crate::held::one_of_each_component;
use crate::improve::InterfaceFunctions;
use crate::interfaces::Interfaces;
use crate::materials::pieces::Pieces;
use crate::verdict::TopologyReport;
use isoparticles_field::materials::{Material, MaterialId};
use isoparticles_field::spline::CubicSpline;
use isoparticles_field::topology::FieldTopology;
use isoparticles_mesh::TriangleMesh;
use isoparticles_mesh::inside::nodes_on_wrong_side;
use isoparticles_volume::{Geometry, Image};
use serde::Serialize;

/// One object or many materials. Positions are in the grid frame, mm.
pub trait Subject: Sync {
    /// Returns the grid.
    fn geometry(&self) -> &Geometry;

    /// Returns the functions of the interfaces.
    fn functions(&self) -> &dyn InterfaceFunctions;

    /// Returns the names of the materials, then of the planes at which they end; empty for one
    /// object.
    fn table(&self) -> &[Material] {
        &[]
    }

    /// Returns the number of the space beyond the first plane, if the materials end at planes.
    fn first_beyond(&self) -> Option<MaterialId> {
        None
    }

    /// Returns the samples of F at the grid nodes, where a node with F = 0 has no side. Empty for
    /// many materials and for an open border.
    fn samples(&self) -> &[f32] {
        &[]
    }

    /// Returns the grid nodes (x fastest, ascending) whose material differs in the mesh, or `None`
    /// if nodes are not compared.
    fn wrong_nodes(&self, interfaces: &Interfaces) -> Option<Vec<usize>>;

    /// Returns the vertices that the improvement must not move.
    fn held(&self, _mesh: &TriangleMesh) -> Vec<u32> {
        Vec::new()
    }

    /// Compares the topology of a mesh with that of the field. `checked` is the check of the mesh.
    fn compare(&self, mesh: &TriangleMesh, checked: &CheckReport) -> Comparison;
}

/// Topology of the field, compared with that of the mesh.
#[derive(Clone, Debug, Serialize)]
#[serde(untagged)]
pub enum Topology {
    /// Of one object.
    Object(TopologyReport),
    /// The components and Euler characteristics of each material.
    Materials(Vec<Pieces>),
}

impl Topology {
    /// Returns the number of components of the field.
    pub fn components(&self) -> usize {
        match self {
            Self::Object(report) => report.field.components,
            Self::Materials(pieces) => pieces.iter().map(|own| own.components).sum(),
        }
    }
}

/// Comparison of the topology of a mesh with that of the field.
pub struct Comparison {
    /// The two topologies.
    pub topology: Topology,
    /// The differences that fail the check, in words.
    pub failed: Vec<String>,
    /// The differences that only cause a warning, in words.
    pub doubtful: Vec<String>,
}

/// One object.
pub struct Object<'a> {
    /// The spline F.
    pub field: &'a CubicSpline,
    /// The topology of F.
    pub topology: &'a FieldTopology,
    /// The samples of F at the grid nodes. `None` if the object is open at the border of the
    /// volume: the sides of the nodes are then not compared.
    pub samples: Option<&'a Image<f32>>,
}

impl Subject for Object<'_> {
    fn geometry(&self) -> &Geometry {
        self.field.geometry()
    }

    fn functions(&self) -> &dyn InterfaceFunctions {
        self.field
    }

    fn samples(&self) -> &[f32] {
        self.samples.map_or(&[], |image| &image.data)
    }

    fn wrong_nodes(&self, interfaces: &Interfaces) -> Option<Vec<usize>> {
        Some(nodes_on_wrong_side(&interfaces.mesh, self.samples?))
    }

    fn held(&self, mesh: &TriangleMesh) -> Vec<u32> {
        one_of_each_component(mesh, self.field, self.topology)
    }

    fn compare(&self, mesh: &TriangleMesh, _checked: &CheckReport) -> Comparison {
        let report = TopologyReport::new(mesh, self.field, self.topology);
        let (failed, doubtful) = report.differences(self.samples.is_none());
        Comparison { topology: Topology::Object(report), failed, doubtful }
    }
}
