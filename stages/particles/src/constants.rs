//! Constants of the particle dynamics, each with its derivation or measurement. The CPU code and
//! the kernels share them: `gpu/constants.rs` declares them in the text of every kernel.
//!
//! # Reach of the neighbour lists
//!
//! A particle interacts with the members of its list. The lists also define the independent classes
//! (of particles on the GPU, of blocks of particles on the CPU). No two members of a class are in
//! each other's lists, so no member reads what another writes, whatever the step length. The step
//! length decides how near two particles can come while neither is in the other's list.
//!
//! A GPU's lists reach `SUPPORT (1 + SKIN)` times the smaller h. They are rebuilt before a pass if
//! a particle has moved by more than [`REBUILD_MOVE`] h since the last time. In one pass a particle
//! moves by at most [`FARTHEST_MOVE`] h. So after any pass, where h is constant, two particles that
//! are not in each other's lists are at least this far apart (`UNSEEN_DISTANCE`, in h):
//!
//! ```text
//! SUPPORT (1 + SKIN) - 2 (REBUILD_MOVE + FARTHEST_MOVE)  =  2.252 - 2 (0.1 + 0.5)  =  1.052
//! ```
//!
//! The CPU rebuilds its lists before every pass, so they need to reach only this distance plus two
//! moves ([`LISTED`], 2.052 h). Density control requires new lists in every pass anyway, and
//! shorter lists are faster to build and to read.
//!
//! The bound must exceed the first ring, 1 h. Then an unlisted pair cannot collide or have more
//! energy than two lattice neighbours, and the lists of the next pass contain it. The bound is
//! pessimistic: both particles move head-on, and the projection moves each as far as its step does.
//! On a surface that is flat within h the projection adds almost nothing. There the bound is
//! 2.252 - 2 (0.1 + 0.25) = 1.55 h. The missed energy (Eq. 1 at d = 0.896) is then at most 0.2 % of
//! a particle's energy.
//!
//! Where h has the gradient g (mm per mm), the larger of the two may move by its own h. The bound
//! is then `SUPPORT (1 + SKIN) (1 - 0.6 g) - 1.2` times the smaller h, 0.65 at g = 0.3. On the CPU
//! it is 2.052 (1 - 0.5 g) - 1, 0.74 at g = 0.3.
//!
//! # Lattices with another spacing
//!
//! With an ideal energy other than that of Eq. 1 the lattice spacing is not h
//! ([`Parameters::spacing`](crate::Parameters::spacing): 0.657 h for the printed 3.462). Lengths of
//! the lattice scale with the *spacing*: [`FIRST_RING`], [`NEWCOMER_DISTANCE`], [`PARENT_DISTANCE`]
//! and the place of a newcomer. Lengths of steps and lists scale with h. The bounds above hold for
//! spacings from [`LEAST_SPACING`] to [`LARGEST_SPACING`].

use isoparticles_field::energy::SUPPORT;

/// Margin of a GPU's neighbour lists beyond the support, as a share of the support. The lists are
/// complete at the start of a pass: `SUPPORT SKIN` = 0.52 h exceeds 2 [`REBUILD_MOVE`] = 0.2 h, by
/// which two particles may have approached each other.
pub(crate) const SKIN: f64 = 0.3;

/// A GPU's lists are rebuilt once a particle has moved by this share of its h since the last time.
/// Upper bound: half of `SUPPORT SKIN`, 0.26.
pub(crate) const REBUILD_MOVE: f64 = 0.1;

/// Longest step in the tangent plane in one pass, as a share of h (the paper's bound is h). With
/// a quarter, [`UNSEEN_DISTANCE`] stays above 1.
pub(crate) const LONGEST_STEP: f64 = 0.25;

/// Maximum distance that a particle may move in one pass, as a share of h: the projection may add
/// as much as the step.
pub(crate) const FARTHEST_MOVE: f64 = 2.0 * LONGEST_STEP;

/// Minimum distance, in h, of two particles that are not in each other's lists, after any pass
/// where h is constant.
pub(crate) const UNSEEN_DISTANCE: f64 = SUPPORT * (1.0 + SKIN) - 2.0 * (REBUILD_MOVE + FARTHEST_MOVE);

/// Reach of the CPU's neighbour lists, in units of the smaller h: [`UNSEEN_DISTANCE`] plus one move
/// of each particle.
pub(crate) const LISTED: f64 = UNSEEN_DISTANCE + 2.0 * FARTHEST_MOVE;

const _: () = assert!(
    UNSEEN_DISTANCE > 1.0,
    "particles that do not see each other could come within the first ring of the lattice"
);
const _: () = assert!(
    SUPPORT * SKIN > 2.0 * REBUILD_MOVE && LISTED > SUPPORT,
    "a pass could start with lists that miss an interaction"
);

/// Maximum lattice spacing, in h (ideal energy 0.554): lattice neighbours must be nearer than
/// unlisted particles can come.
pub(crate) const LARGEST_SPACING: f64 = UNSEEN_DISTANCE;

/// Minimum lattice spacing, in h (ideal energy 7.84): a pass must not move a particle past its
/// neighbour. A GPU's lists have 18.4 / spacing^2 members, 74 here, but there are only 32 classes,
/// so in denser lattices many particles would not move.
pub(crate) const LEAST_SPACING: f64 = FARTHEST_MOVE;

/// Radius that separates the first from the second ring of the hexagonal lattice, in spacings: the
/// geometric mean of the two radii, 1 and sqrt(3).
pub(crate) const FIRST_RING: f64 = 1.316_074_012_952_492_5;

/// Neighbours in the first ring of the hexagonal lattice. A particle with another number is a
/// lattice defect.
pub(crate) const LATTICE_NEIGHBOURS: u32 = 6;

/// Levenberg-Marquardt damping of a particle that has not moved yet (0.1 in the program that the
/// paper compares with).
pub const INITIAL_LAMBDA: f64 = 0.1;

/// Minimum damping. It multiplies diag(H) by 1.001, so the step is nearly the undamped Newton step.
pub(crate) const LEAST_LAMBDA: f64 = 1e-3;

/// A particle whose damping reaches this limit does not move in the pass: the step would be 1e-4 of
/// a Newton step.
pub(crate) const LARGEST_LAMBDA: f64 = 1e4;

/// Factor by which the damping grows after a failed try (Algorithm 1).
pub(crate) const LAMBDA_GROWTH: f64 = 10.0;

/// Factor by which the damping falls after a successful first try (Algorithm 1).
pub(crate) const LAMBDA_FALL: f64 = 0.1;

/// Minimum eigenvalue of the Hessian in the tangent plane, as a share of the larger one. It limits
/// the step along the softer direction to 20 times the step that the stiffer direction would take.
pub(crate) const EIGENVALUE_FLOOR: f64 = 0.05;

/// Maximum distance that the projection may add to a step, as a share of h.
pub(crate) const PROJECTION_REACH: f64 = 0.5;

/// Tolerance of |F| after a step, as a share of the voxel spacing. After the last pass,
/// `settle::finish` projects with a tolerance of 1e-8.
pub(crate) const PASS_TOLERANCE: f64 = 1e-5;

/// Minimum distance of a newcomer from all particles of its interface, other newcomers included, as
/// a share of the lattice spacing. The passes that follow make room for it.
///
/// A newcomer stands one spacing from its parent, in the middle of the widest gap between two
/// neighbours. In the lattice a gap has 60 degrees, so the newcomer is 2 sin(15 degrees) = 0.518
/// spacings from both neighbours. With a larger minimum, a particle with six neighbours never gets
/// a newcomer, and undersampled places remain. Measured (docs/developer/method.md): at 0.45 the
/// count is nearest to the predicted one. At 0.513, where the energy of one pair equals the
/// deletion limit (Eq. 1), the count falls by 1.3 %, and at 0.7 by 10 %, with no better triangles.
pub(crate) const NEWCOMER_DISTANCE: f64 = 0.45;

/// Minimum distance of a newcomer from its parent after the projection, as a share of the lattice
/// spacing. A nearer newcomer is rejected.
pub(crate) const PARENT_DISTANCE: f64 = 0.6;
