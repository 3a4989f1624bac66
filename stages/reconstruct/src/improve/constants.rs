//! Constants of the improvement, with their derivation or measurement. The limits of the acceptance
//! test are in `acceptance`. h is the target edge length at the triangle, edge or vertex.

// --- quality of a triangle ---

/// Minimum radius ratio, and minimum and maximum angle (degrees), for finite elements. A triangle
/// at one of these limits has a quality of at most 0.5.
pub(super) const FIT: f64 = 0.5;
pub(super) const FIT_ANGLES: [f64; 2] = [25.0, 120.0];
/// Soft targets, not enforced by a check. A triangle at one of them has a quality of at most 0.65.
pub(super) const AIM: f64 = 0.65;
pub(super) const AIM_ANGLES: [f64; 2] = [28.0, 105.0];
/// An edge between two junction points is short if it is shorter than this share s of h. A triangle
/// on this edge with two sides of length h has the radius ratio s (2 - s) < 2 s = 0.3 (`POOR`).
pub(super) const SHORT_SIDE: f64 = 0.15;
/// Minimum radius ratio of the check by default (`--min-radius-ratio`). All operations apply to
/// triangles below this quality, even next to junction curves.
pub(super) const POOR: f64 = crate::options::MIN_RADIUS_RATIO;
/// Default target quality of the queue (`--improve-below`), and the minimum quality that the moves
/// of a sweep keep.
pub(super) const GOOD: f64 = 0.9;
/// Above this radius ratio, the minimum angle does not reduce the quality, and the maximum angle
/// would reduce it by at most 0.03. The quality is therefore set to the radius ratio.
pub(super) const SURELY_WIDE: f64 = 0.78;
/// Minimum gain of a move. Smaller gains may be rounding errors and could continue indefinitely.
pub(super) const LEAST_GAIN: f64 = 1e-5;
/// Minimum gain in mean quality of a move of a sweep. A tenth of it raises the mean quality of
/// meshes of 1,000 to 20,000 vertices by 0.0005 to 0.002, in three times the time.
pub(super) const LEAST_MEAN_GAIN: f64 = 1e-4;
/// Contribution of each triangle below a bar to the shortfall, in addition to the squared
/// difference. With it, a move that lifts a triangle from just below the bar also gains.
pub(super) const BELOW: f64 = 1e-3;
/// Gain for each grid node that is brought to its correct side. It exceeds the shortfall of any
/// patch: at most `MOST_TRIANGLES` = 4,000 triangles with at most 1 + `BELOW` each.
pub(super) const NODE: f64 = 1e4;

/// Cosine between normal and grad F from which a triangle follows F. A fold between two such
/// triangles is a fold of F.
pub(super) const FOLLOWS: f64 = 0.5;

// --- distance from F = 0 ---

/// Tolerance of a projection onto F = 0, in voxels.
pub(super) const PROJECTION_TOLERANCE: f64 = 1e-5;
/// If the first-order deviation |F| / |grad F| exceeds this share of h, the distance to a point of
/// F = 0 replaces it. The search radius is the first-order deviation, at most h.
pub(super) const FIRST_ORDER: f64 = 0.15;
/// `LINE_STEPS`: number of samples on each side in the search for a crossing along a line.
/// `HALVINGS`: number of bisections of the interval found, to 2^-20, a millionth, of the sample
/// spacing.
pub(super) const LINE_STEPS: usize = 16;
pub(super) const HALVINGS: usize = 20;

// --- relocation: search for the best position of a vertex in its tangent plane ---

/// Angle in radians by which the eight search directions rotate when the step is halved.
pub(super) const TURN: f64 = 0.3;
/// First and last step, in units of the mean distance to the neighbours (on a junction curve: of
/// the distance to the next vertex).
pub(super) const FIRST_STEP: f64 = 0.25;
pub(super) const LAST_STEP: f64 = 0.01;
/// Maximum move of a vertex on a junction curve, as a share of the way to its neighbour. The edge
/// between them keeps at least a tenth of its length. Collapses remove shorter edges.
pub(super) const FARTHEST_ALONG: f64 = 0.9;
/// Maximum distance between a junction curve and the midpoint of an edge on it after a move, in
/// units of h: half the strict limit for centroids. If the distance was larger before, it must not
/// increase.
pub(super) const CURVE_DEVIATION: f64 = 0.15;
/// Shares of the way to the best position, in the order tried. A shorter way may pass the
/// acceptance test if the full way fails.
pub(super) const SHARES: [f64; 3] = [1.0, 0.5, 0.2];
/// Maximum number of relocation passes after a move, and number of smoothing passes after a flip,
/// before the acceptance test.
pub(super) const PASSES: usize = 2;
/// Change of the minimum quality of the touched triangles, after the first pass, below which the
/// second pass is skipped. 22,044 of 37,157 failed moves are below it, and 52 of 5,171 successful
/// moves (`heart_label` 1 at h = 2.1 mm, `heart_ct` and `brain_parcellation` at 20,000 vertices,
/// `thorax_labels` 1 at 5,000).
pub(super) const HOPELESS_AFTER_RELOCATIONS: f64 = -0.2;

/// The vertices around a collapse are smoothed once for each of these numbers. Before each pass,
/// the collapse is abandoned if the change of the mean quality of the touched triangles is below
/// the number. On the same particles, without and with these limits: `heart_ct` at 75,000 has
/// 75,499 and 75,476 vertices, in 5.2 and 4.5 s; ribs at 5,000 have 5,010 and 5,034; bone at 1,000
/// has 1,130 and 1,147. The mean radius ratios differ by 0.001 at most.
pub(super) const HOPELESS_BEFORE_SETTLINGS: [f64; 3] = [-0.30, -0.008, -0.002];

// --- sweeps over the whole mesh ---

/// Side of a block in units of the mean edge length. With 50, 35, 25 and 18, the 15,000 vertices of
/// the heart take 0.45, 0.39, 0.45 and 0.50 s on two threads. With few blocks, threads wait for the
/// largest block. With many blocks, more vertices lie at the faces between blocks.
pub(super) const BLOCK: f64 = 35.0;
/// Change of the summed quality of the touched triangles, after each of the [`PASSES`] of a flip,
/// below which the flip is abandoned. After the first pass, 18,210 of 19,752 failed flips are below
/// it, and 3 of 1,125 successful flips (`heart_label` 1, h = 2.1 mm).
pub(super) const HOPELESS_AFTER_SWEEP: f64 = -0.05;
/// Number of vertex visits after which smoothing ends even if it still gains, in addition to one
/// visit per vertex for each sweep after the first. With 0, 25,000, 50,000 and 100,000: the 15,000
/// vertices of the heart reach a mean radius ratio of 0.9888, 0.9893, 0.9895 and 0.9895, and the
/// improvement takes 0.27, 0.35, 0.39 and 0.46 s; the 79,000 vertices of the lungs reach 0.9905,
/// 0.9905, 0.9908 and 0.9914 in 1.04, 1.13, 1.26 and 1.43 s.
pub(super) const VISITS: usize = 50_000;
/// Minimum gain in mean quality of a sweep's move per increase of the mean deviation of the touched
/// triangles by h. The table gives the mean radius ratio and the mean distance (voxels) of the
/// centroids from F = 0 for ribs and bone at 5,000 vertices and `heart_label` at h = 1.4 voxels.
/// The last column is the relative error of the area of a cylinder with sharp rims at h = 1.3 (mean
/// of eight seeds of the particles; F itself has -0.73 %).
///
/// | price | ribs           | bone          | heart          | cylinder |
/// |-------|----------------|---------------|----------------|----------|
/// | 0.5   | 0.9779, 0.3583 | 0.9767, 0.492 | 0.9912, 0.0600 | -1.025 % |
/// | 1     | 0.9771, 0.3545 | 0.9756, 0.486 | 0.9905, 0.0592 | -0.983 % |
/// | 1.5   | 0.9764, 0.3537 | 0.9750, 0.483 | 0.9899, 0.0585 | -0.965 % |
/// | 2     | 0.9759, 0.3523 | 0.9747, 0.480 | 0.9892, 0.0581 | -0.955 % |
///
/// With the strict limits on deviation and folds and no price, ribs have 0.9747, 0.3596. These
/// particles differ from those of the table and give 0.9788, 0.3606 at price 0.5.
pub(super) const PRICE_OF_DEVIATION: f64 = 1.5;

// --- remeshing (Botsch and Kobbelt 2004) ---

/// Edges longer than `LONG` h are split, edges shorter than `SHORT` h are collapsed. At these
/// lengths, the edges before and after a move are equally far from h. A split halves an edge:
/// 4/3 - 1 = 1 - 2/3. A collapse to the midpoint lengthens adjacent edges of the same length by
/// half: 1 - 4/5 = 6/5 - 1.
pub(super) const LONG: f64 = 4.0 / 3.0;
pub(super) const SHORT: f64 = 4.0 / 5.0;
/// Minimum number of splits and collapses in a round of an update, per triangle that may change, if
/// another round is to follow. The sweeps and the queue make the remaining changes. The table gives
/// the time of the improvement and the mean radius ratio of the changed triangles of `heart_label`
/// 1 at 20,000 vertices, for two values of h in a ball of 14 mm, instead of 1.86 mm.
///
/// | number | h = 0.93 mm   | h = 3.5 mm    |
/// |--------|---------------|---------------|
/// | 0      | 0.68 s, 0.975 | 0.52 s, 0.947 |
/// | 0.02   | 0.54 s, 0.974 | 0.40 s, 0.951 |
/// | 0.1    | 0.36 s, 0.974 | 0.31 s, 0.947 |
pub(super) const FEW_CHANGES: f64 = 0.1;
/// Minimum quality that splits, collapses and flips keep. The relaxation that follows improves the
/// triangles; its minimum is [`TARGET`].
pub(super) const FLOOR: f64 = 0.35;

// --- queue of bad triangles ---

/// Maximum number of triangles with disjoint surroundings that are processed in parallel.
pub(super) const BATCH: usize = 32;
/// Number of rings of triangles around a triangle that single moves and pairs of moves, with their
/// relocations, may change.
pub(super) const RINGS: usize = 4;
/// Number of first moves of a pair that are tried with second moves: those with the maximum
/// decrease of the shortfall.
pub(super) const FIRST_MOVES: usize = 4;
/// Transactions by which the wasted work at a level of a band may exceed the useful work: about 130
/// single moves or 40 pairs of moves. With 3,000, 6,000 and 10,000, `thorax_ct` above 200 reaches a
/// minimum radius ratio of 0.535, 0.620 and 0.659.
pub(super) const WASTED_WORK_LIMIT: usize = 6_000;
/// Wasted work that a unit of useful work allows for triangles below [`FIT`]. For the others, the
/// two are equal. With factors of 1, 3 and 8, `brain_parcellation` (all materials, 100,000
/// vertices) keeps 658, 176 and 176 triangles below [`FIT`], at minimum radius ratios of 0.230,
/// 0.286 and 0.286. Where few triangles are below [`FIT`], nothing changes.
pub(super) const WORTH_OF_UNFIT: usize = 3;

// --- patch remeshing at a smaller target length, where F bends within h ---

/// The mean edge length in this number of rings around a triangle is the length of the mesh there,
/// if it is below h. With six rings on eight cubes of 4^3 voxels, the rings span the cubes, and the
/// smallest patch has 130 of 1,146 vertices. The improvement then takes four times as many
/// transactions and fails the check (`tests/tests/labelled_cubes.rs`).
pub(super) const RINGS_OF_LENGTH: usize = 2;
/// Radii of the patch in units of the length of the mesh there, in the order tried. The smallest
/// patch that succeeds adds the fewest vertices. Trabecular bone (1,000 vertices requested) has
/// 1,276 vertices before the improvement, 1,284 after a patch of 1.6 and 1,478 after one of 2.5,
/// before superfluous vertices are collapsed.
pub(super) const REACHES: [f64; 2] = [1.6, 2.5];
/// Rates at which target lengths grow with distance, in mm per mm, in the order tried. On noise
/// (the torso CT at 200, both methods), 3 of 1.8 million triangles stay below [`FIT`] with the
/// first rate alone, and none with all three.
pub(super) const GRADATIONS: [f64; 3] = [0.45, 0.3, 0.6];
/// Minimum target length at the rim of a patch, as a share of the length of the mesh there.
pub(super) const RIM: f64 = 0.8;
/// Target length demanded at a grid node on the wrong side, as a share of h or of the length of the
/// mesh there, whichever is less. With 0.5, one node of the tests' ball of three sectors stays on
/// the wrong side; with 0.25, none does.
pub(super) const SHORTER: f64 = 0.25;
/// Maximum distance of a centroid from F = 0 after superfluous vertices are removed, in units of h.
/// With 0.3, a small ellipsoid meshed with needle triangles keeps 36 % of its volume; with 0.2, it
/// keeps more than 50 % (`tests_of_patches`).
pub(super) const COARSEN_DEVIATION: f64 = 0.2;
/// Number of rounds of splits, collapses, flips and relaxation in a patch. The same number of
/// rounds then raises the triangles of the patch to quality [`TARGET`].
pub(super) const ROUNDS: usize = 5;
/// Quality to which the triangles of a patch are raised if possible. Relaxation and the removal of
/// vertices keep it as a minimum.
pub(super) const TARGET: f64 = 0.6;
/// Range of edge lengths in units of the target length while a patch is remeshed.
pub(super) const PATCH_LENGTHS: [f64; 2] = [0.35, 2.3];
/// Maximum number of triangles in a remeshed patch.
pub(super) const MOST_TRIANGLES: usize = 4000;
