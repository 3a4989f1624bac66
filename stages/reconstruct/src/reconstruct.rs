//! The whole stage for one object: turns particles on F = 0 into a checked triangle mesh.
//!
//! 1. The particles are projected onto F = 0, and their Delaunay triangulation is computed.
//! 2. The topology of F = 0 is computed from the spline alone, so that the reference does not
//!    depend on any mesh.
//! 3. Each tetrahedron is labelled as inside if F is negative at its circumcentre, and as outside
//!    otherwise.
//! 4. The facets between inside and outside form the surface, which is closed by construction.
//! 5. Local criteria cover manifold edges and vertices, deviation and normal deviation. Global
//!    criteria cover components, Euler characteristics, critical points of F and voxel centres.
//! 6. A priority queue orders the violations by kind, and each is repaired by a new point on F = 0,
//!    usually the centre of a surface Delaunay ball.
//! 7. Where points do not help, tetrahedra are relabelled. The refinement ends when there are no
//!    violations, no further remedies, or no rounds left in the budget.
//! 8. With `--method tight-cocone`, the shape of the Voronoi cells labels the tetrahedra instead,
//!    and points are added where it lacks a part of the restricted surface.
//! 9. The facets are extracted as a mesh, and parts of the surface that touch at a vertex are
//!    separated.
//! 10. Sweeps and local moves improve the triangles, and an acceptance test preserves the topology.
//! 11. The finished mesh is checked independently of the previous steps, and its topology is
//!     compared with that of F.

use crate::complete::{Completion, size_at};
pub use crate::complete::{Joining, Reconstruction};
use crate::join::{Joined, join};
pub use crate::options::{Method, Options};
use crate::prepare::prepare;
use crate::subject::Object;
use isoparticles_field::particle_set::ParticleSet;
use isoparticles_field::sizing::SizingField;
use isoparticles_field::spline::CubicSpline;
use isoparticles_field::topology::FieldTopology;
use isoparticles_stage::error::Result;
use isoparticles_stage::monitor::Monitor;
use isoparticles_volume::Image;

/// Returns a mesh of F = 0 for particles in the grid frame of `field`, the samples of F. h at a
/// vertex is taken from `sizing`, or else from the nearest point of the triangulation. The result
/// does not depend on the number of threads.
///
/// # Errors
/// If fewer than half of the particles are near F = 0, if all are in one plane, if Tight Cocone
/// finds no solid, or if the run is interrupted. A mesh that fails a check is not an error
/// ([`Reconstruction::failed`]).
pub fn reconstruct(
    particles: &ParticleSet,
    (spline, field): (&CubicSpline, &Image<f32>),
    sizing: Option<&SizingField>,
    options: &Options,
    monitor: &dyn Monitor,
) -> Result<Reconstruction> {
    let phase = monitor.phase("project");
    let mut points = prepare(particles, spline)?;
    drop(phase);
    // concurrent, because the triangulation uses a single thread and both results are independent
    let phase = monitor.phase("triangulate, topology");
    let (delaunay, topology) = rayon::join(|| points.triangulate(), || FieldTopology::watched(spline, monitor));
    let (delaunay, topology) = (delaunay?, topology?);
    drop(phase);
    monitor.check()?;
    let Joined { mut interfaces, points: (places, sizes), joining } =
        join(delaunay, &points, spline, &topology, field, options, monitor)?;

    let subject = Object { field: spline, topology: &topology, samples: (!options.open_border).then_some(field) };
    let size = size_at(sizing, &places, &sizes);
    let completion = Completion { subject: &subject, size: &size, options, monitor };
    let phase = monitor.phase("improve");
    let (improved, _) = completion.improve(&mut interfaces, &[], None, false)?;
    drop(phase);
    completion.check(interfaces, improved, Some(joining), Vec::new())
}
