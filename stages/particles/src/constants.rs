//! The numbers that decide how particles settle, each with its reason, once for the CPU and for the kernels, whose text is
//! composed with declarations made from these (`gpu/constants.rs`).
//!
//! # What the lists miss
//!
//! A particle interacts with those in its list, and the classes that may move together (of particles on the GPU, of blocks of particles on the CPU) are made from
//! the lists: no two members of a class are in each other's list, so none reads what another writes, *whatever the steps are*. What the length of the steps decides is how
//! near two particles can come while neither is in the other's list. A GPU's lists reach `SUPPORT (1 + SKIN)` times the smaller h; they are
//! made anew before a pass once a particle has moved by more than [`REBUILD_MOVE`] h; in a pass none moves by more than [`FARTHEST_MOVE`] h.
//! So at the end of any pass two that do not see each other are no nearer than
//!
//! ```text
//! SUPPORT (1 + SKIN) - 2 (REBUILD_MOVE + FARTHEST_MOVE)  =  2.252 - 2 (0.1 + 0.5)  =  1.052  h        (UNSEEN_DISTANCE)
//! ```
//!
//! where h is even: farther than neighbours in the lattice. The CPU's are made anew before every pass, and reach that far and two moves ([`LISTED`], 2.052 h): while density control is at work they are made
//! anew in every pass either way, and shorter ones are made and read in less time. The bound that must hold is that of the first ring, 1 h: then such a pair can
//! neither collide nor have more energy than two neighbours have in the lattice, and the lists made before the next pass hold it. The
//! bound asks for the worst twice: both go head on, and the projection takes each as far again as its step. On a surface that is flat within
//! h the projection adds next to nothing, the bound is 2.252 - 2 (0.1 + 0.25) = 1.55 h, and the energy that is missed (Eq. 1 at d = 0.896) is
//! at most 0.2 % of a particle's. Where h changes by g a mm, the larger of two may move by its own h: `SUPPORT (1 + SKIN) (1 - 0.6 g) - 1.2` times the smaller
//! h, 0.65 at g = 0.3 (on the CPU 2.052 (1 - 0.5 g) - 1, 0.74).
//!
//! # Lattices of another spacing
//!
//! The lattice that an ideal energy other than that of Eq. 1 asks for has another spacing than h ([`Parameters::spacing`](crate::Parameters::spacing): 0.657 h for the
//! printed 3.462). What is a length of the lattice ([`FIRST_RING`], [`NEWCOMER_DISTANCE`], [`PARENT_DISTANCE`], where a newcomer stands) is that many *spacings*; what
//! is about steps and lists stays in h. The bounds above hold for spacings from [`LEAST_SPACING`] to [`LARGEST_SPACING`].

use isoparticles_field::energy::SUPPORT;

/// A GPU's neighbour lists reach this much farther than the support, as a share of it, so that they stay good while particles move: at the start
/// of a pass they are complete, since `SUPPORT SKIN` = 0.52 h is more than the 2 [`REBUILD_MOVE`] by which two may have come nearer.
pub(crate) const SKIN: f64 = 0.3;

/// A GPU's lists are made anew once a particle has moved by this share of its h since they were made.
pub(crate) const REBUILD_MOVE: f64 = 0.1;

/// Longest step in the tangent plane in one pass, as a share of h (the paper's bound is h).
pub(crate) const LONGEST_STEP: f64 = 0.25;

/// Farthest that a particle may be from its place before a pass, as a share of h: the projection may add as much as the step.
pub(crate) const FARTHEST_MOVE: f64 = 2.0 * LONGEST_STEP;

/// Two particles that are not in each other's lists are farther apart than this many h after any pass, where h is even.
pub(crate) const UNSEEN_DISTANCE: f64 = SUPPORT * (1.0 + SKIN) - 2.0 * (REBUILD_MOVE + FARTHEST_MOVE);

/// The CPU's neighbour lists reach this many times the smaller h.
pub(crate) const LISTED: f64 = UNSEEN_DISTANCE + 2.0 * FARTHEST_MOVE;

const _: () = assert!(
    UNSEEN_DISTANCE > 1.0,
    "particles that do not see each other could come within the first ring of the lattice"
);
const _: () = assert!(
    SUPPORT * SKIN > 2.0 * REBUILD_MOVE && LISTED > SUPPORT,
    "a pass could start with lists that miss an interaction"
);

/// Largest spacing of a lattice in h, that of the ideal energy 0.554: neighbours in it must be nearer than particles that do not see each other.
pub(crate) const LARGEST_SPACING: f64 = UNSEEN_DISTANCE;

/// Smallest spacing of a lattice in h, that of the ideal energy 7.84: a pass must not take a particle past the next one. A GPU's lists have 18.4 over the squared spacing
/// members, 74 here, and 32 classes move on the GPU: of denser ones many would rest.
pub(crate) const LEAST_SPACING: f64 = FARTHEST_MOVE;

/// Neighbours on the hexagonal lattice are nearer than this many spacings (of h), and the next ring is farther: the geometric mean of
/// the two radii, 1 and sqrt(3).
pub(crate) const FIRST_RING: f64 = 1.316_074_012_952_492_5;

/// Neighbours in the first ring of the hexagonal lattice; a particle with another number is a lattice defect.
pub(crate) const LATTICE_NEIGHBOURS: u32 = 6;

/// Levenberg-Marquardt damping of a particle that has not moved yet (0.1 in the program that the paper compares with).
pub const INITIAL_LAMBDA: f64 = 0.1;

/// Smallest damping.
pub(crate) const LEAST_LAMBDA: f64 = 1e-3;

/// A particle whose damping reaches this stays where it is in this pass.
pub(crate) const LARGEST_LAMBDA: f64 = 1e4;

/// Damping grows by this factor when a try fails.
pub(crate) const LAMBDA_GROWTH: f64 = 10.0;

/// Damping falls by this factor when the first try succeeds.
pub(crate) const LAMBDA_FALL: f64 = 0.1;

/// Smallest eigenvalue of the Hessian in the tangent plane, as a share of the larger: a step is no longer than twenty times what the
/// stiffer direction would take.
pub(crate) const EIGENVALUE_FLOOR: f64 = 0.05;

/// The projection of a step may move a particle by this share of h in all.
pub(crate) const PROJECTION_REACH: f64 = 0.5;

/// |F| after a step, as a share of the voxel spacing; the particles are put onto F = 0 to more digits at the end.
pub(crate) const PASS_TOLERANCE: f64 = 1e-5;

/// A newcomer keeps this share of the lattice's spacing (h) from everybody on its sheet, other newcomers included; the lattice makes room for it in the next
/// passes.
///
/// It stands at one spacing from its parent, in the middle of the widest gap between two neighbours. In the lattice that gap is 60 degrees, and the newcomer
/// is 2 sin(15 degrees) = 0.518 of it from both: at more than that a particle with six neighbours never gets one, and places with too few particles stay.
/// Measured (docs/developer/method.md): at 0.45 the count comes nearest to the predicted one; at 0.513, where the energy of one pair (Eq. 1) is what
/// density control deletes at, it falls by 1.3 %, at 0.7 by 10 %, and triangles are no better for it.
pub(crate) const NEWCOMER_DISTANCE: f64 = 0.45;

/// A newcomer that the projection takes nearer than this to its parent, as a share of the lattice's spacing, is none.
pub(crate) const PARENT_DISTANCE: f64 = 0.6;
