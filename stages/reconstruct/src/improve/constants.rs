//! Every number that decides something in the improvement, with its reason where it was derived or measured. Lengths over h are over the target edge length at the place.

// --- what is asked of a triangle ---

/// Smallest radius ratio, smallest and largest angle (degrees) that finite elements are asked for; a triangle at any of them has quality 0.5.
pub(super) const FIT: f64 = 0.5;
pub(super) const FIT_ANGLES: [f64; 2] = [25.0, 120.0];
/// The same that triangles are brought to as far as it goes, which no check asks for: quality 0.65 at any of them.
pub(super) const AIM: f64 = 0.65;
pub(super) const AIM_ANGLES: [f64; 2] = [28.0, 105.0];
/// A side between two junction points, shorter than this part of h, makes every triangle on it poor: with two sides of h its radius ratio is at most twice that, 0.3.
pub(super) const SHORT_SIDE: f64 = 0.15;
/// Quality below which a triangle fails the check by default (`--min-radius-ratio`): nothing is spared on it, at junction curves either.
pub(super) const POOR: f64 = crate::check::MIN_RADIUS_RATIO;
/// Quality that the worst triangles are brought to in so far as a few failures allow, and below which smoothing for the sake of the mean brings none.
pub(super) const GOOD: f64 = 0.9;
/// No triangle of a higher radius ratio is held back by its smallest angle, and none by more than 0.03 by its largest one.
pub(super) const SURELY_WIDE: f64 = 0.78;
/// Gain that counts; what is smaller may be rounding, and would never end.
pub(super) const LEAST_GAIN: f64 = 1e-5;
/// The same for a sweep, in smallest and mean quality together, or in the mean: a tenth of it raises the mean of 1,000 to 20,000 vertices by 0.0005 to 0.002, in
/// thrice the time.
pub(super) const LEAST_GAIN_OF_SWEEP: f64 = 1e-4;
/// What a triangle below a bar counts for beside the square of how far: one just below is worth a move, too.
pub(super) const BELOW: f64 = 1e-3;
/// What a grid node on the wrong side counts for: more than all triangles of a patch can lack.
pub(super) const NODE: f64 = 1e4;

// --- what the guard asks for ---

/// Smallest cosine between a triangle's normal and grad F at its centroid, and between the normals of neighbours.
pub(super) const AGREEMENT: f64 = 0.3;
pub(super) const FOLD: f64 = 0.0;
/// Cosine to grad F from which on a triangle follows it: a fold between two such triangles is one of F.
pub(super) const FOLLOWS: f64 = 0.5;
/// The same limits for a triangle below [`FIT`], and for two moves in a row on one below [`EASY`]: turned by up to a right angle, folds of F up to 143 degrees. A third of h off F = 0 in the
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

/// Angle (radians) by which the eight directions turn when the step is halved.
pub(super) const TURN: f64 = 0.3;
/// First and last step, over the mean distance to the neighbours.
pub(super) const FIRST_STEP: f64 = 0.25;
pub(super) const LAST_STEP: f64 = 0.01;
/// Part of the way to a neighbour on a junction curve that a vertex is moved at most: the edge between them keeps a tenth of its length, and what wants less is a collapse.
pub(super) const FARTHEST_ALONG: f64 = 0.9;
/// Distance from a junction curve, over h, of the middle of an edge along it that a move may bring about: the deviation that centroids of triangles are allowed.
pub(super) const CURVE_STRAYS: f64 = 0.15;
/// Shares of the way to the best place that a vertex is brought on behalf of a bad triangle: where the guard does not let it get there, it may let it
/// come nearer.
pub(super) const SHARES: [f64; 3] = [1.0, 0.5, 0.2];
/// Times that the vertices round a move are relocated in turn.
pub(super) const RELOCATIONS: usize = 2;
/// Change of the smallest quality of the triangles touched, after the first of these, below which the second is left out: 22,044 of 37,157 moves in vain are below it, and 52 of
/// 5,171 that gain (`heart_label` 1 at h = 2.1 mm, `heart_ct` and `brain_parcellation` at 20,000 vertices, `thorax_labels` 1 at 5,000).
pub(super) const HOPELESS_AFTER_RELOCATIONS: f64 = -0.2;

/// The vertices round a collapse are smoothed in turn as often as here are numbers: changes of the mean quality of the triangles touched below which it is given up, before each time. On the same particles,
/// without these and with them: `heart_ct` at 75,000 75,499 vertices and 75,476, 5.2 and 4.5 s; ribs at 5,000 5,010 and 5,034, bone at 1,000 1,130 and 1,147; mean radius ratios by 0.001 at most.
pub(super) const HOPELESS_BEFORE_SETTLINGS: [f64; 3] = [-0.30, -0.008, -0.002];

// --- sweeps over the whole mesh ---

/// Side of a block over the mean length of the edges. With 50, 35, 25 and 18 the heart's 15,000 vertices take 0.45, 0.39, 0.45 and 0.50 s on two threads: of few blocks the largest is waited for, and of many, more vertices lie across the
/// faces.
pub(super) const BLOCK: f64 = 35.0;
/// Times that the four vertices of a flip are smoothed before it is judged.
pub(super) const SWEEPS_OF_FLIP: usize = 2;
/// Change of the summed quality of the triangles touched, after a sweep of that kind, below which a flip is given up: 18,210 of 19,752 flips in vain are below it after the
/// first, and 3 of 1,125 that are kept (`heart_label` 1, h = 2.1 mm).
pub(super) const HOPELESS_AFTER_SWEEP: f64 = -0.05;
/// Visits of vertices by smoothing, beside one a vertex for each sweep asked for, after which it ends also where it still gains. The heart's 15,000 vertices with none, 25,000, 50,000 and 100,000: mean radius ratio
/// 0.9888, 0.9893, 0.9895 and 0.9895, improvement 0.27, 0.35, 0.39 and 0.46 s; the lungs' 79,000: 0.9905, 0.9905, 0.9908 and 0.9914, 1.04, 1.13, 1.26 and 1.43 s.
pub(super) const VISITS: usize = 50_000;
/// Deviation from F = 0 that sweeps may bring about, over the ordinary one. Where vertices are taken away: those of bone asked for 1,000, and the volume that a gyroid thinner than h
/// loses by that, at 1: 1,182, 0.8 %; 1.67: 1,095; 2: 1,075, 4.9 %; 2.1: 1,062, 4.0 %; 2.2: 1,043, 5.1 %. Where vertices move and edges are flipped, which may fold as far as [`LOOSE_FOLD`] where F folds (that leaves
/// 73 degrees within, as between the faces of a regular tetrahedron; [`LOOSE_FOLD_OF_F`] makes flatter tetrahedra of `heart_ct` at 20,000): at [`PRICE_OF_DEVIATION`].
pub(super) const FARTHER: f64 = 2.1;
/// Mean quality that a sweep's move has to gain for each h that the mean deviation of the triangles touched grows by. Mean radius ratio and mean distance of centroids from F = 0 (voxels) of ribs and of bone at
/// 5,000 and `heart_label` at h = 1.4 voxels, and area of a cylinder with sharp rims (mean of eight seeds of particles; F itself has -0.73 %), at h = 1.3: 0.5: 0.9779, 0.3583; 0.9767, 0.492; 0.9912, 0.0600;
/// -1.025 %; 1: 0.9771, 0.3545; 0.9756, 0.486; 0.9905, 0.0592; -0.983 %; 1.5: 0.9764, 0.3537; 0.9750, 0.483; 0.9899, 0.0585; -0.965 %; 2: 0.9759, 0.3523; 0.9747, 0.480; 0.9892, 0.0581; -0.955 %. By the
/// ordinary limits on deviation and folds, at no price, ribs have 0.9747 and 0.3596 (particles of an earlier build, 0.9788 and 0.3606 at 0.5).
pub(super) const PRICE_OF_DEVIATION: f64 = 1.5;

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
/// First moves, of those that leave least to do, each of which is followed by a second one.
pub(super) const FIRST_MOVES: usize = 4;
/// Quality below which a single move nearly always helps.
pub(super) const EASY: f64 = 0.7;
/// Transactions that a pass may waste beyond its useful ones: some 65 single moves, 20 pairs
/// or one patch. With 3,000 and 2,000 `heart_ct` at 20,000 vertices reaches a minimum radius ratio
/// of 0.754 and 0.601. With 3,000 the eight cubes of `tests/tests/labelled_cubes.rs` take half as
/// many as with 20,000 for triangles below [`FIT`], and reach a mean of 0.937 in place of 0.935.
pub(super) const WASTED_WORK_LIMIT: usize = 3_000;

// --- remeshing of a patch at a smaller length, where F bends within h ---

/// Rings round a triangle whose mean edge is the length of the mesh there, where that is below h.
/// Six rings span eight cubes of 4^3 voxels: their smallest patch has 130 of 1,146 vertices, and
/// they take four times as many transactions and fail the check (`tests/tests/labelled_cubes.rs`).
pub(super) const RINGS_OF_LENGTH: usize = 2;
/// Radii of the patch over the length at its rim, in the order tried: the smallest that cures adds the fewest vertices (trabecular bone asked for
/// 1,000 has 1,276 before the improvement, 1,284 after a patch of 1.6 and 1,478 after one of 2.5, before superfluous vertices are collapsed).
pub(super) const REACHES: [f64; 4] = [1.6, 2.5, 4.0, 6.0];
/// Lengths grow by so much with the distance, mm per mm, in the order tried. With the first alone 3 triangles of 1.8 million on noise (the torso
/// CT at 200, both methods) stay below [`FIT`], with all three none.
pub(super) const GRADATIONS: [f64; 3] = [0.45, 0.3, 0.6];
/// Times that a patch is remeshed with each, the next with what the outcome of the one before asks
/// for. With 4 in place of 2, minimum and mean radius ratio of `heart_ct` at 20,000 vertices,
/// `thorax_labels` 1 with `sizefield --vertices 5000` and labelled cubes of 2 to 5 voxels are the
/// same.
pub(super) const ATTEMPTS: usize = 2;
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
