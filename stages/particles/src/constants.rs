//! Constants of the particle dynamics, each with its derivation or measurement. The CPU code and
//! the GPU kernels share them: `gpu/constants.rs` declares them in the source of every kernel.
//!
//! # Reach of the neighbour lists
//!
//! A particle interacts with the members of its list. The lists also define the independent classes
//! (of particles on the GPU, of blocks of particles on the CPU). No two members of a class are in
//! each other's lists. No member therefore reads data that another member writes, whatever the step
//! length. The step length determines how close two particles can come while neither is in the
//! other's list.
//!
//! A GPU's lists reach `SUPPORT (1 + SKIN)` times the smaller h. They are rebuilt before a pass if
//! a particle has moved by more than [`REBUILD_MOVE`] h since they were last built. In one pass a
//! particle moves by at most [`FARTHEST_MOVE`] h. If h is constant, two particles that are not in
//! each other's lists are therefore at least this far apart after any pass (`UNSEEN_DISTANCE`, in
//! units of h):
//!
//! ```text
//! SUPPORT (1 + SKIN) - 2 (REBUILD_MOVE + FARTHEST_MOVE)  =  2.252 - 2 (0.1 + 0.5)  =  1.052
//! ```
//!
//! The CPU rebuilds its lists before every pass, so they need to reach only this distance plus two
//! moves ([`LISTED`], 2.052 h). Density control requires new lists in every pass anyway, and
//! shorter lists are faster to build and to read.
//!
//! The bound must exceed the radius of the first ring, 1 h. Then an unlisted pair cannot collide,
//! cannot have more energy than two lattice neighbours, and is in the lists of the next pass. The
//! bound is pessimistic: it assumes that both particles move head-on and that the projection moves
//! each particle as far as its step does. On a surface that is flat within h the projection adds
//! almost nothing. There the bound is 2.252 - 2 (0.1 + 0.25) = 1.55 h, and the missed energy (Eq. 1
//! at d = 0.896) is at most 0.2 % of a particle's energy.
//!
//! If h has the gradient g (mm per mm), the particle with the larger h may move by its own h. The
//! bound is then `SUPPORT (1 + SKIN) (1 - 0.6 g) - 1.2` times the smaller h, which is 0.65 at g =
//! 0.3. On the CPU the bound is 2.052 (1 - 0.5 g) - 1, which is 0.74 at g = 0.3.
//!
//! # Lattices with another spacing
//!
//! If the ideal energy differs from that of Eq. 1, the lattice spacing differs from h
//! ([`Parameters::spacing`](crate::Parameters::spacing): 0.657 h for the printed 3.462). Lengths of
//! the lattice scale with the *spacing*: [`FIRST_RING`], [`NEWCOMER_DISTANCE`], [`PARENT_DISTANCE`]
//! and the position of a newcomer. Lengths of steps and lists scale with h. The bounds above hold
//! for spacings from [`LEAST_SPACING`] to [`LARGEST_SPACING`].

use isoparticles_field::energy::SUPPORT;

/// Margin of a GPU's neighbour lists beyond the support, as a share of the support. It keeps the
/// lists complete at the start of a pass: two particles may have approached each other by 2
/// [`REBUILD_MOVE`] = 0.2 h, which is less than `SUPPORT SKIN` = 0.52 h.
pub(crate) const SKIN: f64 = 0.3;

/// A GPU's lists are rebuilt after a particle has moved by this share of its h since they were last
/// built. Upper bound: half of `SUPPORT SKIN`, 0.26.
pub(crate) const REBUILD_MOVE: f64 = 0.1;

/// Maximum step length in the tangent plane per pass, as a share of h (the paper's bound is h).
/// With a quarter, [`UNSEEN_DISTANCE`] stays above 1.
pub(crate) const LONGEST_STEP: f64 = 0.25;

/// Maximum distance that a particle moves per pass, as a share of h: the projection may add as much
/// as the step.
pub(crate) const FARTHEST_MOVE: f64 = 2.0 * LONGEST_STEP;

/// Minimum distance, in units of h, between two particles that are not in each other's lists, after
/// any pass with constant h.
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

/// Maximum lattice spacing in units of h (ideal energy 0.554): lattice neighbours must be closer
/// together than unlisted particles can come.
pub(crate) const LARGEST_SPACING: f64 = UNSEEN_DISTANCE;

/// Minimum lattice spacing in units of h (ideal energy 7.84): a pass must not move a particle past
/// its neighbour. A GPU's list has 18.4 / spacing^2 members, 74 at this spacing. There are only 32
/// classes, so in denser lattices many particles would not move.
pub(crate) const LEAST_SPACING: f64 = FARTHEST_MOVE;

/// Radius in lattice spacings that separates the first from the second ring of the hexagonal
/// lattice: the geometric mean of the two ring radii, 1 and sqrt(3).
pub(crate) const FIRST_RING: f64 = 1.316_074_012_952_492_5;

/// Number of neighbours in the first ring of the hexagonal lattice. A particle with a different
/// number is a lattice defect.
pub(crate) const LATTICE_NEIGHBOURS: u32 = 6;

/// Levenberg-Marquardt damping of a particle that has not moved yet (0.1 in the program that the
/// paper compares with).
pub const INITIAL_LAMBDA: f64 = 0.1;

/// Minimum damping. It multiplies diag(H) by 1.001, so the step is nearly an undamped Newton step.
pub(crate) const LEAST_LAMBDA: f64 = 1e-3;

/// A particle whose damping reaches this limit does not move in the pass: its step would be 1e-4 of
/// a Newton step.
pub(crate) const LARGEST_LAMBDA: f64 = 1e4;

/// Factor that multiplies the damping after a rejected attempt (Algorithm 1).
pub(crate) const LAMBDA_GROWTH: f64 = 10.0;

/// Factor that multiplies the damping if the first attempt is accepted (Algorithm 1).
pub(crate) const LAMBDA_FALL: f64 = 0.1;

/// Minimum eigenvalue of the Hessian in the tangent plane, as a share of the larger eigenvalue. It
/// limits the step along the softer direction to 20 times the step that the stiffer direction would
/// allow.
pub(crate) const EIGENVALUE_FLOOR: f64 = 0.05;

/// Maximum distance that the projection may add to a step, as a share of h.
pub(crate) const PROJECTION_REACH: f64 = 0.5;

/// Tolerance of |F| after a step, as a share of the voxel spacing. After the last pass,
/// `settle::finish` projects with a tolerance of 1e-8.
pub(crate) const PASS_TOLERANCE: f64 = 1e-5;

/// Minimum distance of a newcomer from all particles of its interface, including other newcomers,
/// as a share of the lattice spacing. Subsequent passes move the neighbours apart.
///
/// A newcomer is placed one spacing from its parent, in the middle of the widest gap between two
/// neighbours. In the lattice a gap has 60 degrees, so the newcomer is 2 sin(15 degrees) = 0.518
/// spacings from both neighbours. With a larger minimum, a particle with six neighbours never gets
/// a newcomer, and undersampled regions remain. Measured (docs/developer/method.md): at 0.45 the
/// count is closest to the predicted count. At 0.513, where the energy of one pair equals the
/// deletion limit (Eq. 1), the count falls by 1.3 %, and at 0.7 by 10 %, without better triangles.
pub(crate) const NEWCOMER_DISTANCE: f64 = 0.45;

/// Minimum distance of a newcomer from its parent after the projection, as a share of the lattice
/// spacing. A newcomer below this distance is rejected.
pub(crate) const PARENT_DISTANCE: f64 = 0.6;
