//! Every number that decides something in the improvement, with its reason. Lengths over h are over the target edge length at the place.

// --- what is asked of a triangle ---

/// Smallest radius ratio, smallest and largest angle (degrees) that finite elements are asked for; a triangle at any of them has quality 0.5.
pub(super) const FIT: f64 = 0.5;
pub(super) const FIT_ANGLES: [f64; 2] = [25.0, 120.0];
/// A triangle of a higher radius ratio keeps both angles: 8 sin(A/2) sin(B/2) sin(C/2) of one with A at either is at most 0.679.
pub(super) const SURELY_FIT: f64 = 0.68;
/// Gain that counts; what is smaller may be rounding, and would never end.
pub(super) const LEAST_GAIN: f64 = 1e-5;
/// What a triangle below a bar counts for beside the square of how far: one just below is worth a move, too.
pub(super) const BELOW: f64 = 1e-3;
/// The same for a sweep, in smallest and mean quality together: a tenth of it moves vertices for ever without a mean that shows it.
pub(super) const LEAST_GAIN_OF_SWEEP: f64 = 1e-4;

// --- what the guard asks for ---

/// Smallest cosine between a triangle's normal and grad F at its centroid, and between the normals of neighbours.
pub(super) const AGREEMENT: f64 = 0.3;
pub(super) const FOLD: f64 = 0.0;
/// Cosine to grad F from which on a triangle follows it: a fold between two such triangles is one of F.
pub(super) const FOLLOWS: f64 = 0.5;
/// The same limits for a triangle below [`FIT`]: turned by up to a right angle, folds of F up to 143 degrees. A third of h off F = 0 in the
/// middle of a triangle, where F has detail below h, does less harm than a needle. Moves within them leave 34 of 229 patches of the torso CT
/// at 200 to be remeshed (restricted).
pub(super) const LOOSE_AGREEMENT: f64 = 0.0;
pub(super) const LOOSE_FOLD: f64 = -0.3;
pub(super) const LOOSE_FOLD_OF_F: f64 = -0.8;
pub(super) const LOOSE_DEVIATION: f64 = 0.35;
/// Edges over h there: short enough for what bends within a tenth of h, and as long as two edges within the range in a row.
pub(super) const LOOSE_LENGTHS: [f64; 2] = [0.05, 3.0];
/// For bringing a vertex onto F = 0, which comes before all but crossing triangles: the smallest cosine to grad F.
pub(super) const PROJECTION_AGREEMENT: f64 = -0.2;

// --- F = 0 ---

/// Distance from F = 0, in voxels, beyond which a vertex does not lie on it, and that a projected one may keep.
pub(super) const ON_SURFACE: f64 = 5e-5;
pub(super) const PROJECTION_TOLERANCE: f64 = 1e-5;
/// Distance from F = 0, over h, up to which the first order |F| / |grad F| is taken for it, and up to which a point of F = 0 is sought.
pub(super) const FIRST_ORDER: f64 = 0.15;
pub(super) const MOST_DEVIATION: f64 = 1.0;
/// Samples on either side in the search for a crossing along a line, and halvings of the interval found (to a millionth of a sample).
pub(super) const LINE_STEPS: usize = 16;
pub(super) const HALVINGS: usize = 20;

// --- relocation: the best place of a vertex by a search over its tangent plane ---

/// Directions looked in at each step, and the angle (radians) by which they turn when the step is halved.
pub(super) const DIRECTIONS: usize = 8;
pub(super) const TURN: f64 = 0.3;
/// First and last step, over the mean distance to the neighbours.
pub(super) const FIRST_STEP: f64 = 0.25;
pub(super) const LAST_STEP: f64 = 0.01;
/// Times that the vertices round a move are relocated in turn.
pub(super) const RELOCATIONS: usize = 2;

// --- sweeps over the whole mesh ---

/// Side of a block over the mean length of the edges: some thousands of triangles, and an eighth of the vertices across its faces.
pub(super) const BLOCK: f64 = 50.0;
/// Relaxations of the four vertices of a flip before it is judged.
pub(super) const SWEEPS_OF_FLIP: usize = 2;

// --- remeshing (Botsch and Kobbelt 2004) ---

/// Edges longer and shorter than these times h are split and collapsed: either halves or doubles to the same distance from h.
pub(super) const LONG: f64 = 4.0 / 3.0;
pub(super) const SHORT: f64 = 4.0 / 5.0;
/// Quality that a split, collapse or flip, and that a relaxation may leave behind where it was better: the next comes after.
pub(super) const FLOOR: f64 = 0.35;
pub(super) const FLOOR_OF_RELAXATION: f64 = 0.6;

// --- the queue of bad triangles ---

/// Triangles, worst first, that are worked on side by side where their surroundings do not meet.
pub(super) const BATCH: usize = 32;
/// Rings of triangles that a move with the relocations after it stays within.
pub(super) const RINGS: usize = 4;
/// Patches remeshed in vain, a second or so each, after which F has too much detail below h for the rest.
pub(super) const MOST_IN_VAIN: usize = 200;

// --- remeshing of a patch at a smaller length, where F bends within h ---

/// Rings round a triangle whose mean edge is the length of the mesh there, where that is below h.
pub(super) const RINGS_OF_LENGTH: usize = 6;
/// Radii of the patch over the length at its rim, in the order tried: the first is enough for edges to grow from the shortest to that. The others are for
/// triangles that it leaves, whose rim lies badly.
pub(super) const REACHES: [f64; 4] = [2.5, 4.0, 1.6, 6.0];
/// Lengths grow by so much with the distance, mm per mm, in the order tried. With the first alone 3 triangles of 1.8 million on noise (the torso
/// CT at 200, both methods) stay below [`FIT`], with all three none.
pub(super) const GRADATIONS: [f64; 3] = [0.45, 0.3, 0.6];
/// Times that a patch is remeshed with each, the next with what the outcome of the one before asks for.
pub(super) const ATTEMPTS: usize = 4;
/// The target length is this share of the radius of curvature, at which triangles near to equilateral stray and fold little (Amenta and Bern
/// 1999), no less than this share of the length at the rim, and no less than this one where the patch ends.
pub(super) const CHORD: f64 = 1.0;
pub(super) const FINEST: f64 = 0.08;
pub(super) const RIM: f64 = 0.8;
/// A triangle of the outcome asks for a length of this share of its mean side, when its centroid is farther from F = 0 than this share of
/// that, or the cosine between its normal and grad F is below this.
pub(super) const SHORTER: f64 = 0.5;
pub(super) const STRAYS: f64 = 0.2;
pub(super) const TURNED: f64 = 0.6;
/// Rounds of splits, collapses, flips and relaxation, and the quality that the triangles of the patch are lifted to afterwards.
pub(super) const ROUNDS: usize = 5;
pub(super) const TARGET: f64 = 0.6;
/// Range of edge lengths over the target length on the way.
pub(super) const PATCH_LENGTHS: [f64; 2] = [0.35, 2.3];
/// Most triangles that remeshing may leave in a patch.
pub(super) const MOST_TRIANGLES: usize = 4000;
