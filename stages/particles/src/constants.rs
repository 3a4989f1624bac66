//! Constants of the particle dynamics, each with its derivation or measurement. The CPU code and
//! the GPU kernels share them: `gpu/constants.rs` declares them in the source of every kernel.
//!
//! # Reach of the neighbour lists
//!
//! A particle interacts only with members of its neighbour list. The lists also define the
//! independent classes (of particles on the GPU, of blocks of particles on the CPU). Particles that
//! move concurrently are never in each other's lists. Whatever the step length, none of them
//! therefore reads data that another one writes. The step length determines how close two particles
//! can come while neither is in the other's list.
//!
//! On the GPU, the lists reach `SUPPORT (1 + SKIN)` times the smaller h of the two particles. They
//! are rebuilt before a pass if a particle has moved by more than [`REBUILD_MOVE`] h since they
//! were last built. In one pass a particle moves by at most [`FARTHEST_MOVE`] h. If h is constant,
//! two particles that are not in each other's lists are therefore at least this far apart after any
//! pass (`UNSEEN_DISTANCE`, in units of h):
//!
//! ```text
//! SUPPORT (1 + SKIN) - 2 (REBUILD_MOVE + FARTHEST_MOVE)  =  2.252 - 2 (0.1 + 0.5)  =  1.052
//! ```
//!
//! The CPU rebuilds its lists before every pass, so they need to reach only this distance plus one
//! move of each particle ([`CPU_LIST_REACH`], 2.052 h). Density control requires new lists in every
//! pass anyway, and shorter lists are faster to build and to read.
//!
//! The bound must exceed 1 h, the distance between lattice neighbours. Then two unlisted particles
//! cannot collide or have more energy than two lattice neighbours. If they interact, the lists of
//! the next pass contain them. The bound is pessimistic: it assumes that the two particles move
//! straight towards each other and that the projection adds as much displacement as the step. On a
//! surface that is nearly flat at the scale of h, the projection adds almost nothing. There the
//! bound is 2.252 - 2 (0.1 + 0.25) = 1.55 h, and the energy of an unlisted pair (Eq. 1 at d =
//! 0.896) is at most 0.2 % of the energy of a lattice particle.
//!
//! If the gradient of h has magnitude g (mm per mm), the same fractions of the larger h limit the
//! displacement of the particle with the larger h. The bound is then
//! `SUPPORT (1 + SKIN) (1 - 0.6 g) - 1.2` times the smaller h (0.65 at g = 0.3). On the CPU the
//! factor is `2.052 (1 - 0.5 g) - 1` (0.74 at g = 0.3).
//!
//! # Lattices with another spacing
//!
//! The default ideal energy is the energy (Eq. 1) of a particle in the lattice of edge h. With any
//! other ideal energy, the lattice spacing differs from h
//! ([`Parameters::spacing`](crate::Parameters::spacing): 0.657 h for the printed 3.462). Lattice
//! lengths scale with the *spacing*: [`FIRST_RING`], [`NEWCOMER_DISTANCE`], [`PARENT_DISTANCE`] and
//! the distance at which a newcomer is placed. Step lengths and the reach of the lists scale with
//! h. The bounds above hold for spacings from [`LEAST_SPACING`] to [`LARGEST_SPACING`].

use isoparticles_field::energy::SUPPORT;

/// Margin of the GPU's neighbour lists beyond the support, as a fraction of the support. It keeps
/// the lists complete at the start of a pass: two particles may have approached each other by twice
/// [`REBUILD_MOVE`], 0.2 h, which is less than `SUPPORT * SKIN` = 0.52 h.
pub(crate) const SKIN: f64 = 0.3;

/// Displacement of a particle since the last rebuild of the GPU's lists, as a fraction of its h,
/// beyond which the lists are rebuilt. It must be less than half of `SUPPORT * SKIN`, 0.26.
pub(crate) const REBUILD_MOVE: f64 = 0.1;

/// Maximum step length in the tangent plane per pass, as a fraction of h (the paper's bound is h).
/// With this value, [`UNSEEN_DISTANCE`] stays above 1.
pub(crate) const LONGEST_STEP: f64 = 0.25;

/// Maximum displacement of a particle per pass, as a fraction of h: the projection may add as much
/// as the step, [`LONGEST_STEP`].
pub(crate) const FARTHEST_MOVE: f64 = 2.0 * LONGEST_STEP;

/// Minimum distance, in units of h, between two particles that are not in each other's lists, after
/// any pass with constant h.
pub(crate) const UNSEEN_DISTANCE: f64 = SUPPORT * (1.0 + SKIN) - 2.0 * (REBUILD_MOVE + FARTHEST_MOVE);

/// Reach of the CPU's neighbour lists, in units of the smaller h: [`UNSEEN_DISTANCE`] plus one move
/// of each particle.
pub(crate) const CPU_LIST_REACH: f64 = UNSEEN_DISTANCE + 2.0 * FARTHEST_MOVE;

const _: () = assert!(
    UNSEEN_DISTANCE > 1.0,
    "particles that do not see each other could come within the first ring of the lattice"
);
const _: () = assert!(
    SUPPORT * SKIN > 2.0 * REBUILD_MOVE && CPU_LIST_REACH > SUPPORT,
    "a pass could start with lists that miss an interaction"
);

/// Maximum lattice spacing in units of h (ideal energy 0.554): lattice neighbours must be closer
/// together than any unlisted pair.
pub(crate) const LARGEST_SPACING: f64 = UNSEEN_DISTANCE;

/// Minimum lattice spacing in units of h (ideal energy 7.84): a pass must not move a particle past
/// its neighbour. On a GPU, a neighbour list has `18.4 / spacing^2` members, 74 at this spacing.
/// There are only 32 classes, so in denser lattices many particles would not move.
pub(crate) const LEAST_SPACING: f64 = FARTHEST_MOVE;

/// Radius in lattice spacings that separates the first from the second ring of the hexagonal
/// lattice: the geometric mean of the two ring radii, 1 and sqrt(3).
pub(crate) const FIRST_RING: f64 = 1.316_074_012_952_492_5;

/// Number of neighbours in the first ring of the hexagonal lattice. A particle with a different
/// number is a lattice defect.
pub(crate) const LATTICE_NEIGHBOURS: u32 = 6;

/// Levenberg-Marquardt damping of a particle that has not moved yet. BioMesh3D, with which the
/// paper compares its method, also uses 0.1.
pub const INITIAL_LAMBDA: f64 = 0.1;

/// Minimum damping. With it, diag(H) is multiplied by 1.001, so the step is nearly an undamped
/// Newton step.
pub(crate) const LEAST_LAMBDA: f64 = 1e-3;

/// Maximum damping. A particle whose damping reaches it does not move in the pass: its step would
/// be 1e-4 of a Newton step. Seven rejected attempts raise the damping from its minimum to its
/// maximum.
pub(crate) const LARGEST_LAMBDA: f64 = 1e4;

/// Factor that multiplies the damping after a rejected attempt (Algorithm 1).
pub(crate) const LAMBDA_GROWTH: f64 = 10.0;

/// Factor that multiplies the damping if the first attempt is accepted (Algorithm 1).
pub(crate) const LAMBDA_FALL: f64 = 0.1;

/// Minimum eigenvalue of the Hessian in the tangent plane, as a fraction of the larger eigenvalue.
/// With this minimum, a force gives a step at most 20 times as long along the softer direction as
/// along the stiffer one. Measured on the torus described at [`REST_SHARE`] with `--levels 1`: at
/// 0.0125, 0.025, 0.05, 0.1 and 0.2, a run takes 77, 91, 89, 83 and 74 passes, and 15.3, 13.2,
/// 12.9, 13.7 and 15.1 % of the particles remain lattice defects.
pub(crate) const EIGENVALUE_FLOOR: f64 = 0.05;

/// Maximum difference between an eigenvalue of a 2 x 2 Hessian and the mean of both, as a fraction
/// of the mean, at which the CPU treats the two as equal. At this difference the rounding error of
/// the eigenvectors is about 2e-16 / 1e-12 = 2e-4 radians.
pub(crate) const EQUAL_EIGENVALUES_F64: f64 = 1e-12;

/// Minimum force times h, as a fraction of the energy. Below it, a particle on the CPU does not
/// move: a step would reduce the energy by about 1e-24 of its value, the square of this fraction,
/// which f64 cannot resolve.
pub(crate) const LEAST_FORCE: f64 = 1e-12;

/// Maximum displacement by the projection, in addition to the step length, as a fraction of h. A
/// step is accepted only if it ends within [`FARTHEST_MOVE`] h of the particle. By the triangle
/// inequality, this limit rejects no step that would otherwise be accepted.
pub(crate) const PROJECTION_REACH: f64 = FARTHEST_MOVE;

/// Tolerance of |F| after a step, as a fraction of the voxel spacing. It is near the resolution of
/// f32 positions on a GPU: between 64 and 128 voxels from the origin, the last bit of a coordinate
/// is 2^-17 = 0.8e-5 voxels. After the last pass, the tolerance is [`FINAL_TOLERANCE`].
pub(crate) const PASS_TOLERANCE: f64 = 1e-5;

/// Tolerance of |F| after the last pass, as a fraction of the voxel spacing. One Newton step
/// suffices: it reduces an error e = 1e-5 voxels ([`PASS_TOLERANCE`]) to about e^2 = 1e-10 voxels.
pub(crate) const FINAL_TOLERANCE: f64 = 1e-8;

/// Minimum distance of a newcomer from all particles of its interface, including other newcomers,
/// as a fraction of the lattice spacing. Subsequent passes move the neighbours apart.
///
/// A newcomer is placed one spacing from its parent, in the middle of the widest gap between two
/// neighbours. In the lattice a gap spans 60 degrees, so the newcomer is 2 sin(15 degrees) = 0.518
/// spacings from both neighbours. With a minimum above 0.518, a particle with six neighbours never
/// gets a newcomer, and undersampled regions remain. Measured (docs/developer/method.md): at 0.45
/// the count is closest to the predicted count. At 0.513, where the energy of one pair equals the
/// deletion limit (Eq. 1), the count falls by 1.3 %, and at 0.7 by 10 %; the triangle quality does
/// not improve.
pub(crate) const NEWCOMER_DISTANCE: f64 = 0.45;

/// Minimum distance of a newcomer from its parent after the projection, as a fraction of the
/// lattice spacing. A closer newcomer is rejected. On a sphere of radius R, a point in the tangent
/// plane, one spacing s from the parent, is projected to a distance of 2 R sin(atan(s / R) / 2)
/// from the parent. This distance is 0.6 s for R = 0.61 s. A smaller sphere has room for at most
/// five lattice particles (4 pi R^2 / (0.866 s^2) = 5.4), too few for six neighbours.
///
/// This is also the minimum distance of an edge midpoint from other particles when the edges of a
/// level are split. Measured for midpoints on the surfaces described at [`REST_SHARE`]: at 0.3, 0.6
/// and 0.8, the heart takes 74, 85 and 100 passes, and 18.8, 18.3 and 19.5 % of its particles
/// remain lattice defects. On the torus, no midpoint is omitted.
pub(crate) const PARENT_DISTANCE: f64 = 0.6;

/// Number of passes over which the stop test averages the change in lattice defects. The number of
/// defects fluctuates from pass to pass, so with a short window a fluctuation can end the run too
/// early. Measured on the surfaces described at `REST_SHARE` with one level: with windows of 1, 2,
/// 5, 10 and 20 passes, the heart stops at pass 24, 33, 35, 50 and 50 with 28.6, 25.7, 25.5, 23.0
/// and 23.0 % lattice defects. The torus stops at pass 25, 57, 77, 79 and 96 with 26.1, 17.2, 14.1,
/// 14.1 and 12.3 %.
pub const DEFECT_WINDOW: usize = 10;

/// Default of [`Parameters::defect_tolerance`](crate::Parameters::defect_tolerance). Measured on
/// the surfaces described at [`REST_SHARE`]: at 0.00375, 0.0075, 0.015 and 0.03, the heart takes
/// 87, 85, 69 and 69 passes, and 18.5, 18.3, 18.6 and 20.9 % of its particles remain lattice
/// defects. The torus takes 89, 88, 86 and 57 passes, and 4.7, 4.9, 5.3 and 7.9 % of its particles
/// remain lattice defects.
pub(crate) const DEFECT_TOLERANCE: f64 = 7.5e-3;

/// Default of [`Parameters::rest_share`](crate::Parameters::rest_share). Measured with the options
/// `--backend cpu --rest-share X` on the heart of docs/developer/method.md ("Departures from the
/// printed method") and on a torus (`phantom torus --size 128`, `distfield --iso 100`, `sizefield
/// --uniform 1.2`). At 0.0005, 0.001, 0.002, 0.02 and 1, the heart takes 102, 88, 85, 85 and 61
/// passes, and 16.7, 18.0, 18.3, 18.3 and 21.4 % of its particles remain lattice defects. The torus
/// takes 88 passes at values from 0.002 to 1, and 99 at 0.0005.
pub(crate) const REST_SHARE: f64 = 2e-3;

/// Number of passes over which the test for balanced density control averages. Where h does not
/// suit the surface (h is large relative to the radius of curvature, or the surface has voxel
/// steps), density control adds and deletes particles at the same positions indefinitely. Measured
/// with 20, 14 and 10 passes: `heart_ct` at 75,000 vertices takes 3.8, 3.2 and 2.9 s and reaches a
/// mean radius ratio of 0.9859, 0.9856 and 0.9855. `heart_label` at h = 1.4 voxels takes 0.50, 0.38
/// and 0.32 s and reaches 0.9899, 0.9892 and 0.9889.
pub(crate) const BALANCE_WINDOW: usize = 14;

/// Minimum of [`Parameters::rest_share`](crate::Parameters::rest_share) on levels before the last.
/// On these levels density control need not come to rest, because the next level controls the
/// density again. Measured on the surfaces described at [`REST_SHARE`]: at 0.002, 0.01, 0.05 and
/// 0.2, the heart takes 96, 85, 85 and 66 passes over all levels, and 19.7, 18.3, 18.3 and 20.7 %
/// of its particles remain lattice defects. The torus takes 88 or 89 passes.
pub(crate) const COARSE_REST_SHARE: f64 = 5e-2;

/// Maximum number of passes without density control at the end of a level before the last. The next
/// level moves these particles anyway. Measured with 10 and 3 passes: the lungs of `thorax_labels`
/// (79,000 particles, h = 1.64 mm) take 1.67 and 1.44 s and reach a mean radius ratio of 0.9907 and
/// 0.9901. `heart_label` at h = 2.1 mm takes 0.43 and 0.38 s and reaches 0.9888 and 0.9887.
pub(crate) const COARSE_CLOSING_PASSES: u64 = 3;

/// Number of passes between two spatial sorts of the particles. Checkpoints are written only just
/// before a sort, so this is also the minimum interval between checkpoints. Measured with 5, 10, 20
/// and 40 passes: label 1 of `thorax_labels` takes 5.0, 4.7, 4.7 and 4.7 s on two processor cores
/// and 0.21, 0.20, 0.20 and 0.21 s on an H200 (step `settle` of the report).
pub const REORDER_INTERVAL: u64 = 10;

/// Minimum distance between the seeds of the coarsest level, in lattice spacings. With this value,
/// about as many seeds remain as the hexagonal lattice has particles. Random sequential selection
/// with minimum distance r keeps `0.70 / r^2` points per unit area. The lattice of edge h has
/// `1.155 / h^2` points per unit area, and 0.70 / 0.776^2 = 1.16.
pub(crate) const SEED_SEPARATION: f64 = 0.776;

/// Minimum distance, in lattice spacings, of an added seed from all particles when the edges of a
/// level are split. Only parts of the surface that are too small for the coarser lattice get such
/// seeds: the heart described at [`REST_SHARE`] gets 31, the torus 3. Measured with 0.7, 0.8, 0.9
/// and 1: the heart ends with 4791, 4751, 4757 and 4731 particles (predicted 4847) and 18.1, 16.6,
/// 18.3 and 20.2 % lattice defects, and the torus with 17,455, 17,445, 17,411 and 17,415 particles.
pub(crate) const FILLER_SEPARATION: f64 = 0.9;

/// Maximum length, in lattice spacings, of an edge that is split. It exceeds sqrt(2), the diagonal
/// of a square of lattice edges. Crossing edges are rejected separately. Measured on the surfaces
/// described at [`REST_SHARE`] with 1.316 ([`FIRST_RING`]), 1.45, 1.7 and 2: the torus ends with
/// 17,383 particles at 1.316 and with 17,411 particles at the other values. On the heart, 19.2,
/// 18.3, 20.4 and 21.3 % of the particles remain lattice defects.
pub(crate) const LONGEST_EDGE: f64 = 1.45;
