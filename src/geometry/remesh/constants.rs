//! The constants of the remesh, each with its unit and its reason.
//!
//! Purpose: one table. What the operators, the objective and the queue of local improvement agree on comes first, then what
//! each other part has for itself. Lengths are shares of the mean edge around, unless said otherwise.
//! Invariant: a number stands here once. Must not know: who uses it.

// Operators.

/// Valence of a vertex of the regular triangulation.
pub(super) const REGULAR_VALENCE: usize = 6;
/// The least and the largest valence of an inner vertex that flips keep.
pub(super) const VALENCES: [usize; 2] = [5, 7];
/// Those that they may make where an edge of a curve is recovered: the curve counts for more than a valence.
pub(super) const RECOVERY_VALENCES: [usize; 2] = [4, 8];
/// Cosine: the normals of flipped facets keep it to the mean of the two before. Less than that of a relocation, since an edge
/// across a ridge turns both facets.
pub(super) const FLIPPED_COSINE: f64 = 0.3;
/// Cosine: facets keep it to their marked normals where the distance from the input is measured.
pub(super) const MEASURED_COSINE: f64 = 0.5;
/// The same where it is not measured.
pub(super) const UNMEASURED_COSINE: f64 = 0.8;

// Shapes. Scores and angles are degrees; see `triangle::score`.

/// Degrees that Q = 1 counts for in a score. The smallest angle decides for slender triangles, Q for those whose longest
/// edge is too long.
pub(super) const DEGREES_PER_QUALITY: f64 = 55.0;
/// Where distances are measured, no facet falls below this score, or below what it had. Higher, and ridges of nefertiti with
/// 50,000 points stick out by a fifth more.
pub(super) const LEAST_SCORE: f64 = 35.3;
/// There facets cost something below this score: a margin of two degrees keeps others from falling below the least.
pub(super) const MEASURED_SCORE: f64 = LEAST_SCORE + 2.0;
/// Where distances are not measured, facets of a lower score than this, or of a larger angle, are poor: they are improved, and
/// the fit makes none. An isotropic remesh has about 37°, and one facet in 200 is obtuse.
pub(super) const POOR_SCORE: f64 = 37.0;
pub(super) const POOR_ANGLE: f64 = 92.5;
/// There facets cost something beyond this: a margin of three degrees.
pub(super) const UNMEASURED_SCORE: f64 = POOR_SCORE + 3.0;
pub(super) const UNMEASURED_ANGLE: f64 = POOR_ANGLE - 3.0;
/// A facet that lacks so many degrees costs 1, as much as the largest distance allowed.
pub(super) const SCORE_SCALE: f64 = 3.0;
/// The score that facets around a recovered edge are to have.
pub(super) const RECOVERY_SCORE: f64 = 30.0;
/// The score that facets around a vertex of a curve may fall to where the vertex becomes regular: sides of a curve that have
/// no room for two facets become regular with acute ones. It is a Q of .55.
pub(super) const CURVE_SCORE: f64 = 30.3;

// Objective of one vertex. A cost of 1 is that of the largest distance allowed.

/// Cost of a facet with Q = 0.
pub(super) const QUALITY_WEIGHT: f64 = 0.3;
/// Cost of the vertex's own squared distance at the largest allowed.
pub(super) const OWN_WEIGHT: f64 = 0.3;
/// Distances below this share of the largest allowed cost nothing.
pub(super) const FREE_SHARE: f64 = 0.55;
/// A place has to cost so much less than the one before.
pub(super) const LEAST_GAIN: f64 = 1e-4;
/// The same in a pass over the whole result: smaller gains are not seen and take most of its time.
pub(super) const LEAST_GAIN_OF_PASS: f64 = 1e-3;

// Relocation.

/// First step.
pub(super) const FIRST_STEP: f64 = 0.2;
/// How often a vertex may halve its step: 1/80 of an edge is not seen.
pub(super) const MAX_HALVINGS: u8 = 4;
/// Directions of a step in the plane.
pub(super) const DIRECTIONS: usize = 8;
/// Share of a step along the normal: the surface is known better than the place on it.
pub(super) const NORMAL_STEP: f64 = 0.5;
/// A vertex moves no farther than this in all where the distance is measured,
pub(super) const FARTHEST_MOVE: f64 = 0.6;
/// in the tangent plane or along its curve where it is not,
pub(super) const FARTHEST_TANGENTIAL: f64 = 0.4;
/// across its curve: less, and the tip between two creases of fandisk stays at 28°; more, and fandisk is farther off,
pub(super) const FARTHEST_ACROSS: f64 = 0.11;
/// and at the end of its curve.
pub(super) const FARTHEST_OF_END: f64 = 0.07;
/// Moves for shapes, at most, for each vertex at or beside a poor facet.
pub(super) const MOVES_PER_VERTEX: usize = 40;
/// Vertices that are relocated at the same time, at most: few beside those that wait, so that the costliest come first.
pub(super) const SHAPES_AT_ONCE: usize = 128;
/// Of these, so many at least are one task.
pub(super) const SHAPES_PER_TASK: usize = 8;

// Edges of curves. Lengths are shares of the shortest edge of a curve at the vertex.

/// Shares of its move by which a vertex that left the envelope goes back.
pub(super) const BACKTRACKING: [f64; 4] = [0.25, 0.5, 0.75, 1.0];
/// Passes over these vertices, at most: each depends on its two neighbours.
pub(super) const RESTORING_PASSES: usize = 3;
/// Passes over vertices whose edges are too far from their curves, at most: four for shorter steps, eight that move.
pub(super) const TIGHTENING_PASSES: usize = 12;
/// First step there.
pub(super) const FIRST_TIGHTENING_STEP: f64 = 0.1;
/// Such a vertex moves no farther than this in all,
pub(super) const FARTHEST_TIGHTENED: f64 = 0.25;
/// and a corner no farther than this.
pub(super) const FARTHEST_OF_CORNER: f64 = 0.12;

// Patches.

/// Cosine at which neighbouring facets may meet in any case; the input may have such edges.
pub(super) const SHARPEST_COSINE: f64 = -0.75;
/// The midpoint of an edge of the input is a point to compare with if the edge is longer than this,
pub(super) const LONG_EDGE: f64 = 0.3;
/// and if a vertex of the patch is within this.
pub(super) const MIDPOINT_REACH: f64 = 0.65;
/// Facets of a patch, at most. Its memory grows with their square, and each trial copies it. Vertices with seven
/// neighbours have patches of sixty facets.
pub(super) const MAX_FACETS: usize = 512;
/// Share of the one-ring's radius within which the input has to be known around a vertex: all points whose distances are
/// taken lie within it.
pub(super) const KNOWN_SHARE: f64 = 0.8;

// Trials on a patch.

/// Passes of relocation that every trial gets: most of the bad ones show after the first.
pub(super) const FIRST_PASSES: usize = 1;
/// So many trials go on. With three, rocker-arm with 5,000 points is up to a sixth farther off.
pub(super) const PROMISING_TRIALS: usize = 4;
/// Passes that these get.
pub(super) const FURTHER_PASSES: usize = 2;
/// So many go on to the end, one after the other until one reaches its goal,
pub(super) const FINALISTS: usize = 2;
/// with so many passes: what ten do not reach, more do not.
pub(super) const LAST_PASSES: usize = 12;
/// Trials that the further passes left at more than this share of the distance are dropped: what these do not move, later ones
/// do not move either.
pub(super) const HOPELESS_SHARE: f64 = 0.99;
/// A facet that lacks so many degrees of score counts as much as the distance of the place, where trials are compared.
pub(super) const TRIAL_SCORE_SCALE: f64 = 10.0;

// The queue of places.

/// Places nearer to the input than this are left alone.
pub(super) const NEAR_SHARE: f64 = 0.06;
/// A place is improved if its distance falls to this share of what it was.
pub(super) const GAIN: f64 = 0.95;
/// No more far places are tried after so many that could not be improved. With four, nefertiti with 50,000 points is up to a
/// quarter farther off;
pub(super) const MAX_FAILURES: usize = 8;
/// and after so many that were, plus this share of the vertices.
pub(super) const MAX_IMPROVED: usize = 4;
pub(super) const MAX_IMPROVED_SHARE: f64 = 0.0015;
/// Nor places nearer than this share of one that could not be improved, as long as nothing changes there.
pub(super) const FAILED_SHARE: f64 = 0.8;
/// A vertex is measured if its estimated distance is at least this share of [`NEAR_SHARE`] of its longest edge,
pub(super) const ESTIMATE_SHARE: f64 = 0.65;
/// so many vertices at most. With 100, fandisk with 3,000 points is a fifth farther off.
pub(super) const MAX_MEASURED: usize = 1000;
/// A place enters the queue again if its distance has fallen below this share of what it was when it entered.
pub(super) const STALE_SHARE: f64 = 0.98;
/// Where a valence or a shape is improved, distances below this are allowed in any case.
pub(super) const FREE_DISTANCE: f64 = 0.02;
/// Vertices whose valence is improved, at most.
pub(super) const MAX_IRREGULAR: usize = 500;
/// Rounds of the queue: some vertices have room for a flip only after far places were improved.
pub(super) const QUEUE_ROUNDS: usize = 2;
/// Flips that are tried at a far place, those first that bring a facet nearest to the point that is farthest off. With three,
/// rocker-arm with 5,000 points is farther off at some seeds; with all of them, a third more time for the same distances.
pub(super) const MAX_FLIPS: usize = 5;
/// Independent patches around irregular vertices that are made at the same time, at most. Far places are taken one by one, since
/// the budget is for the farthest: with four at once, rocker-arm with 5,000 points is 6 % farther off.
pub(super) const PATCHES_AT_ONCE: usize = 64;
/// Places among which they are sought,
pub(super) const LOOK_AHEAD: usize = 128;
/// and far places for each thread among which those are sought that it may make ahead.
pub(super) const FAR_LOOK_AHEAD: usize = 4;

// Attributes.

/// Normals of vertices in one place with at least this cosine are equal, up to the rounding of a file.
pub(super) const SAME_NORMAL: f64 = 0.999;
/// Squared length below which the direction of an interpolated normal is all rounding.
pub(super) const LEAST_NORMAL_SQUARED: f64 = 1e-18;
/// Radius of the ball that a walk keeps to, as a multiple of half the distance between its ends. Over a right-angled crease, 1 is
/// enough.
pub(super) const SEAM_REACH: f64 = 1.3;
/// The same for a second walk, if the first reached neither its end nor a seam, as around a thin edge of the surface.
pub(super) const LONG_SEAM_REACH: f64 = 4.0;
/// Facets of one walk, at most.
pub(super) const MAX_SEAM_FACETS: usize = 1 << 16;
/// An end is reached within this share of the distance between the ends.
pub(super) const SEAM_END_REACH: f64 = 1e-6;
/// A texture coordinate beyond a seam is extrapolated by no more than so many times the texture's stretch in the start facet.
pub(super) const MOST_STRETCH: f64 = 4.0;

// Deviation of the input and Hausdorff estimate.

/// Without a tolerance, vertices of the input were missed if one of them is farther away than the first share of a mean edge:
/// then all beyond the second share.
pub(super) const MISSED_SHARES: [f64; 2] = [0.25, 0.17];
/// Vertices or facets per parallel task, at least.
pub(super) const ITEMS_PER_TASK: usize = 256;
/// A sample covers the surface around it within so many square roots of its area.
pub(super) const SAMPLE_REACH: f64 = 2.0;
/// Work of one vertex, as the token counts it.
pub(super) const WORK_PER_VERTEX: usize = 64;

// Closest point of a one-ring.

/// Squared distance that makes up for the rounding of a lower bound near zero, unit box.
pub(super) const ZERO_SQUARED: f64 = 1e-24;
/// Squared lengths below this count as zero: their inverses would be all rounding.
pub(super) const ZERO_LENGTH_SQUARED: f64 = 1e-200;

// Curves to keep, and their envelope. Lengths are edge lengths of the result unless said otherwise.

/// Length of the shortest crease with a free end, edge lengths. Shorter ones are noise of a scan, or folds that fade out.
pub(super) const SHORTEST_CREASE: f64 = 8.0;
/// Length over which bends of a curve are measured, edge lengths.
pub(super) const BEND_REACH: f64 = 1.0;
/// A ridge that is bent less than a crease is a curve if nothing within this distance of it is bent, edge lengths.
pub(super) const SMOOTH_REACH: f64 = 2.5;
/// Corners joined by less boundary than this are one if little is cut off, edge lengths. With both, a triangle between them
/// would have an angle of about as many radians.
pub(super) const JOINED_CORNERS: f64 = 0.4;
/// Distance from its boundary that an edge may have, as a share of the edge length;
pub(super) const BOUNDARY_LIMIT: f64 = 0.08;
/// that from its crease;
pub(super) const CREASE_LIMIT: f64 = 0.06;
/// and that of an edge at a corner that two curves leave at an acute angle: no facet between them has a good angle anyway.
pub(super) const ACUTE_LIMIT: f64 = 0.3;
/// Share of the seeds that curves may take if there are creases. Boundaries alone may take all: a strip that is narrower than an
/// edge has no other seeds.
pub(super) const LARGEST_SHARE: f64 = 0.6;
/// Curves that need more than so many times the seeds plus [`SPARE_SEEDS`] are dropped before any seed is placed.
pub(super) const MOST_SEEDS: usize = 16;
pub(super) const SPARE_SEEDS: usize = 1000;
/// Other seeds are drawn at this distance from a curve's seeds, as a share of their spacing: about where the cells of the curve
/// end. With more, too few seeds would lie between two close curves, and no step takes a seed across a curve.
pub(super) const CLEARANCE: f64 = 0.5;
/// One in so many points is drawn in addition, since some are too near to a curve.
pub(super) const SPARE_POINTS: usize = 50;
/// The share of points that is taken to be clear of the curves, at least.
pub(super) const LEAST_CLEAR: f64 = 0.2;
/// A curve is straight at an edge if it leaves the edge's line by no more than this share of the edge. A curved one is off its
/// chords anyway; a straight one, such as the edge of a plate, shows any dent.
pub(super) const STRAIGHTNESS: f64 = 1e-3;
/// So many edges to either side have to be straight as well.
pub(super) const STRAIGHT_EDGES: usize = 3;

// Fit and its backtracking.

/// Rounds of the whole fit: each finds the nearest points anew.
pub(super) const FIT_ROUNDS: usize = 2;
/// Rounds that halve the moves of bad facets,
pub(super) const BACKTRACKING_HALVINGS: usize = 4;
/// and rounds after these that drop them.
pub(super) const BACKTRACKING_DROPS: usize = 4;
/// Facets per parallel task, at least.
pub(super) const FACETS_PER_TASK: usize = 256;

// Normal equations of the fit.

/// Steps of conjugate gradients in a round. A move spreads by one facet a step.
pub(super) const GRADIENT_STEPS: usize = 14;
/// The steps end at this share of the first squared residual (r·z).
pub(super) const RESIDUAL_SHARE: f64 = 1e-8;
/// Weight of a move in the tangent plane beside a residual of the same length, so that a vertex does not slide. On rocker-arm
/// with 5,000 points 0.05 leaves 4 % more RMS distance; 0.01 costs 0.002 of mean quality.
pub(super) const TANGENT_DAMPING: f64 = 0.02;
/// Weight of the difference between the moves of neighbours: a vertex that is pulled takes them along.
pub(super) const STIFFNESS: f64 = 0.02;
/// Weight of a move along the normal. It keeps the system regular where samples are few.
pub(super) const NORMAL_DAMPING: f64 = 0.01;
/// Weight of a residual of a curve beside one of the surface: the eye follows curves.
pub(super) const CURVE_WEIGHT: f64 = 20.0;
/// Vertices per parallel task, and facets at least.
pub(super) const VERTICES_PER_RUN: usize = 256;
/// Samples between two questions to the token.
pub(super) const SAMPLES_PER_CHECK: usize = 64;
/// Blocks of a row for which memory is reserved: six neighbours on average, and one more.
pub(super) const BLOCKS_PER_ROW: usize = 7;

// Boundary ears.

/// The smallest angle of an ear, degrees. With less, the boundary is near the missing edge as it is: within a tenth of its
/// length.
pub(super) const LEAST_EAR_ANGLE: f64 = 12.0;
/// The least cosine between the normals of an ear and of its neighbours.
pub(super) const LEAST_EAR_COSINE: f64 = 0.5;
/// Passes, at most. Ears that have a vertex in common are added in different passes.
pub(super) const EAR_PASSES: usize = 3;

// Manifold repair.

/// Share of the way to the centroids of its facets by which a copy of a split vertex moves.
pub(super) const STEP_BACK: f64 = 1.0 / 16.0;
/// Share of its shortest edge by which a vertex moves along its normal to leave another one.
pub(super) const SIDE_STEP: f64 = 1e-3;
/// Rounds that double edges, at most: a facet may have three such edges, and its parts may have new ones.
pub(super) const MAX_SEPARATION_ROUNDS: usize = 4;

// Rounds of an attempt, and extraction.

/// Rounds that add seeds, where a tolerance was given.
pub(super) const ADDING_ROUNDS: usize = 8;
/// Rounds that move seeds which produced no vertex.
pub(super) const MOVING_ROUNDS: usize = 1;
/// A round that adds seeds counts as better unless its deviation grows by this factor: more seeds are better although another
/// place may come out a little worse than those that seeds were added to.
pub(super) const ADDING_SLACK: f64 = 2.0;
/// The same for a round after which fewer seeds have no vertex.
pub(super) const MOVING_SLACK: f64 = 1.25;
/// Share of the tolerance by which a vertex may leave its curve: the chords between such vertices are off as well.
pub(super) const OFF_CURVE_SHARE: f64 = 0.5;

// Components apart.

/// Distance between components: so many edge lengths,
pub(super) const SEPARATION_EDGES: f64 = 2.0;
/// plus this share of the diagonal.
pub(super) const SEPARATION_DIAGONAL: f64 = 0.02;
/// Points that a component needs: a tetrahedron has four vertices.
pub(super) const POINTS_PER_COMPONENT: usize = 4;

// Schedule of steps.

/// Rounds that push seeds off curves after the last step. In the last one the curves adopt the seeds instead.
pub(super) const CLEARING_ROUNDS: usize = 2;
/// Steps after such a round.
pub(super) const CLEARING_STEPS: usize = 3;
/// Steps after seeds were moved or added.
pub(super) const REFINING_STEPS: usize = 6;
/// Seeds nearer to each other than this, unit frame, are in one place.
pub(super) const SAME_PLACE: f64 = 1e-9;

// Thin parts.

/// Rounds that draw seeds again, at most.
pub(super) const MAX_THIN_ROUNDS: usize = 6;
/// Rounds without a better result, at most: with other seeds, other cells may fail.
pub(super) const MAX_VAIN_ROUNDS: usize = 3;
/// Factor on edge lengths at failing cells in a round: twice as many cells around what one cell reached around.
pub(super) const THIN_SHORTER: f64 = 0.5;
/// Factor by which the median edge may grow for it: half of the points may go to thin parts.
pub(super) const THIN_LONGEST: f64 = 1.4;
/// Factor by which the number of points may grow where edge lengths imply it.
pub(super) const THIN_MOST_POINTS: usize = 2;

// Number of vertices.

/// A number of vertices is right within this share of what was asked for,
pub(super) const COUNT_LIMIT: f64 = 0.015;
/// or within so many.
pub(super) const COUNT_SLACK: usize = 2;
/// Vertices that a further seed brings, at least; what two rounds say may be chance.
pub(super) const LEAST_SLOPE: f64 = 0.7;
/// Factor on the change of the number of seeds after a round in vain.
pub(super) const VAIN_STRETCH: f64 = 1.5;
/// Rounds that draw fewer seeds, at most.
pub(super) const MAX_COUNT_ROUNDS: usize = 4;
/// Seeds are no fewer than this share of the vertices that were asked for.
pub(super) const FEWEST_SEEDS_SHARE: f64 = 0.1;
/// Nor than this, the vertices of a tetrahedron.
pub(super) const FEWEST_SEEDS: f64 = 4.0;

// Refinement to a tolerance.

/// Rounds with shorter edges, at most.
pub(super) const MAX_REFINING_ROUNDS: usize = 9;
/// Rounds that only make edges shorter where the result is too far. Later ones use up the points by the last round.
pub(super) const LOCAL_ROUNDS: usize = 6;
/// Rounds in a row without progress, at most. In the second one, all edges are shorter.
pub(super) const MAX_VAIN_REFINING: usize = 2;
/// Factor on the number of points in a round after one without progress.
pub(super) const VAIN_GROWTH: f64 = 2.0;
/// Progress is a largest distance below this share of the least one so far,
pub(super) const PROGRESS_SHARE: f64 = 0.95;
/// or a share of missed samples below this share of the least one so far.
pub(super) const FEWER_MISSED: f64 = 0.8;
/// Edges become as short as brings a sample to this share of the tolerance: the largest distances are half as large again as
/// the mean.
pub(super) const TOLERANCE_AIM: f64 = 0.7;
/// In one round edges do not become shorter than this share of what they were. At a crease that was not kept the distance is
/// proportional to the length, and there may be other causes.
pub(super) const SHORTEST_SHARE: f64 = 0.35;
/// If no larger share of the samples is missed after the last round, seeds are added there.
pub(super) const FEW_MISSED_SHARE: f64 = 0.002;
/// A result with this share of the points that are allowed has used them up.
pub(super) const SPENT_SHARE: f64 = 0.95;
/// Times that seeds are added to given ones, each time to come nearer.
pub(super) const MAX_ADDING_TIMES: usize = 3;

// Rounding.

/// Factor on bounds of angles and distances: what is nearer to the bound is left to the exact computation.
pub(super) const BOUND_ROUNDING: f64 = 1.0 - 1e-9;
/// Factor by which the radius of a search grows, so that rounding leaves nothing outside.
pub(super) const RADIUS_ROUNDING: f64 = 1.0 + 1e-9;
/// Squares below this share of a squared bound have roots below the bound despite rounding.
pub(super) const SQUARE_ROUNDING: f64 = 1.0 - 1e-12;
