//! The constants of the remesh, each with its unit and its reason.
//!
//! Purpose: one table. It begins with what the operators, the objective and the queue of local improvement share; each
//! other part follows. Lengths are shares of the mean edge of the one-ring unless a comment says otherwise.

// Operators.

/// Valence of a vertex of the regular triangulation.
pub(super) const REGULAR_VALENCE: usize = 6;
/// Least and largest valence of an inner vertex that flips keep.
pub(super) const VALENCES: [usize; 2] = [5, 7];
/// Least and largest valence that the recovery of a curve's edge may make: the curve counts for more than a valence.
pub(super) const RECOVERY_VALENCES: [usize; 2] = [4, 8];
/// The same where the surface is open without the edge, and the least score there.
pub(super) const NECESSARY_VALENCES: [usize; 2] = [3, usize::MAX];
pub(super) const NECESSARY_SCORE: f64 = 2.0;
/// Least cosine between the normals of flipped facets and the mean before. An edge across a ridge turns both facets.
pub(super) const FLIPPED_COSINE: f64 = 0.3;
/// Least cosine between a facet's normal and its marked normal where the distance from the input is measured, and where not.
pub(super) const MEASURED_COSINE: f64 = 0.5;
pub(super) const UNMEASURED_COSINE: f64 = 0.8;

// Shapes. Scores and angles are degrees; see `triangle::score`.

/// Degrees that Q = 1 counts for in a score. The smallest angle decides for slender triangles, Q for too long an edge.
pub(super) const DEGREES_PER_QUALITY: f64 = 55.0;
/// Least score of a facet where distances are measured, or its own. A higher one lets dense ridges stick out a fifth more.
pub(super) const LEAST_SCORE: f64 = 35.3;
/// Where distances are measured, a facet costs something from this many degrees above the least score on.
pub(super) const SCORE_MARGIN: f64 = 2.0;
/// Score below which a facet is poor where distances are not measured. Poor facets are improved, and the fit makes none. An
/// isotropic remesh has smallest angles of about 37°.
pub(super) const POOR_SCORE: f64 = 37.0;
pub(super) const POOR_ANGLE: f64 = 92.5;
/// Score below which a facet costs something where distances are not measured: a margin of three degrees.
pub(super) const UNMEASURED_SCORE: f64 = POOR_SCORE + 3.0;
pub(super) const UNMEASURED_ANGLE: f64 = POOR_ANGLE - 3.0;
/// Missing degrees of score that cost 1, as much as the largest distance allowed.
pub(super) const SCORE_SCALE: f64 = 3.0;
/// Least score of the facets around a recovered edge.
pub(super) const RECOVERY_SCORE: f64 = 30.0;
/// Least score of the facets around a vertex of a curve that becomes regular. Sides of a curve without room for two facets
/// become regular with acute ones. It is a Q of 0.55.
pub(super) const CURVE_SCORE: f64 = 30.3;

// Objective of one vertex. A cost of 1 is that of the largest distance allowed.

/// Cost of a facet with Q = 0.
pub(super) const QUALITY_WEIGHT: f64 = 0.3;
/// Cost of the vertex's own squared distance at the largest allowed.
pub(super) const OWN_WEIGHT: f64 = 0.3;
/// Distances below this share of the largest allowed cost nothing.
pub(super) const FREE_SHARE: f64 = 0.55;
/// Least gain of a move, cost.
pub(super) const LEAST_GAIN: f64 = 1e-4;
/// Least gain of a move in a pass over the whole result: smaller gains are not visible and take most of its time.
pub(super) const LEAST_GAIN_OF_PASS: f64 = 1e-3;

// Relocation.

pub(super) const FIRST_STEP: f64 = 0.2;
/// Halvings of a vertex's step, at most: 1/80 of an edge is not visible.
pub(super) const MAX_HALVINGS: u8 = 4;
/// Directions of a step in the plane.
pub(super) const DIRECTIONS: usize = 8;
/// Share of a step along the normal: the surface is known better than the place on it.
pub(super) const NORMAL_STEP: f64 = 0.5;
/// Input vertices a cell from which on a patch has one in each cube with sides of this part of an edge: more take as many times as long, and
/// hardly change what is nearest.
pub(super) const DENSE_INPUT: usize = 64;
pub(super) const CUBE_OF_POINTS: f64 = 0.125;
/// Largest total move of a vertex where the distance is measured.
pub(super) const FARTHEST_MOVE: f64 = 0.6;
/// Largest total move in the tangent plane or along a curve where the distance is not measured.
pub(super) const FARTHEST_TANGENTIAL: f64 = 0.4;
/// Largest total move across a curve. With less, tips between creases keep angles of 28°; with more, it deviates more.
pub(super) const FARTHEST_ACROSS: f64 = 0.11;
pub(super) const FARTHEST_OF_END: f64 = 0.07;
/// Moves for shapes per vertex at or beside a poor facet, at most.
pub(super) const MOVES_PER_VERTEX: usize = 40;
/// Vertices that are relocated at the same time, at most: few of those that wait, so that the costliest come first.
pub(super) const SHAPES_AT_ONCE: usize = 128;

// Edges of curves. Lengths are shares of the shortest edge of a curve at the vertex.

/// Shares of its move by which a vertex that left the envelope goes back.
pub(super) const BACKTRACKING: [f64; 4] = [0.25, 0.5, 0.75, 1.0];
/// Passes over vertices that left the envelope, at most: each vertex depends on its two neighbours.
pub(super) const RESTORING_PASSES: usize = 3;
/// Passes over vertices whose edges are too far from their curves, at most: four for shorter steps, eight that move.
pub(super) const TIGHTENING_PASSES: usize = 12;
pub(super) const FIRST_TIGHTENING_STEP: f64 = 0.1;
/// Largest total move of a vertex whose edges are too far from their curves.
pub(super) const FARTHEST_TIGHTENED: f64 = 0.25;
pub(super) const FARTHEST_OF_CORNER: f64 = 0.12;

// Patches.

/// Cosine at which neighbouring facets may always meet; the input may have such edges.
pub(super) const SHARPEST_COSINE: f64 = -0.75;
/// Length of an input edge from which on its midpoint is a sample of the input.
pub(super) const LONG_EDGE: f64 = 0.3;
/// Largest distance of such a midpoint from a vertex of the patch.
pub(super) const MIDPOINT_REACH: f64 = 0.65;
/// Facets of a patch, at most. Memory grows with their square, and trials copy it. Around valence seven there are sixty.
pub(super) const MAX_FACETS: usize = 512;
/// Share of the one-ring's radius within which the input is known around a vertex: all measured points lie within it.
pub(super) const KNOWN_SHARE: f64 = 0.8;

// Trials on a patch.

/// Relocation passes of every trial: most bad trials show after the first.
pub(super) const FIRST_PASSES: usize = 1;
/// Trials that continue after the first passes. Tried: 3 and 4; with 3 results deviate by up to a sixth more.
pub(super) const PROMISING_TRIALS: usize = 4;
/// Further passes of these trials.
pub(super) const FURTHER_PASSES: usize = 2;
/// Trials that continue to the end, one after the other until one reaches its goal.
pub(super) const FINALISTS: usize = 2;
/// Passes of a trial that continues to the end. More than ten rarely help.
pub(super) const LAST_PASSES: usize = 12;
/// Share of the distance above which a trial is dropped after the further passes: later passes do not improve it either.
pub(super) const HOPELESS_SHARE: f64 = 0.99;
/// Missing degrees of score that count as much as the distance of the place, where trials are compared.
pub(super) const TRIAL_SCORE_SCALE: f64 = 10.0;

// The queue of places.

/// Places nearer to the input than this are not improved.
pub(super) const NEAR_SHARE: f64 = 0.06;
/// A place counts as improved if its distance falls to this share.
pub(super) const GAIN: f64 = 0.95;
/// Far places in vain that end the tries. Tried: 4 and 8; with 4 dense results deviate by up to a quarter more.
pub(super) const MAX_FAILURES: usize = 8;
/// Improved far places that end the tries, plus [`MAX_IMPROVED_SHARE`] of the vertices.
pub(super) const MAX_IMPROVED: usize = 4;
pub(super) const MAX_IMPROVED_SHARE: f64 = 0.0015;
/// Places nearer than this share of a failed one are skipped while nothing changes there.
pub(super) const FAILED_SHARE: f64 = 0.8;
/// A vertex is measured if its estimated distance is at least this share of [`NEAR_SHARE`] of its longest edge.
pub(super) const ESTIMATE_SHARE: f64 = 0.65;
/// Vertices that are measured, at most. Tried: 100 and 1,000; with 100 results with creases deviate by a fifth more.
pub(super) const MAX_MEASURED: usize = 1000;
/// A place enters the queue again if its distance fell below this share of the value at its entry.
pub(super) const STALE_SHARE: f64 = 0.98;
/// Distance that is always allowed where a valence or a shape is improved.
pub(super) const FREE_DISTANCE: f64 = 0.02;
/// Score up to which the worst facets of an even result are improved, where distances do not grow. An equilateral triangle has 55.
pub(super) const GOOD_SCORE: f64 = 38.8;
/// Least gain of such a facet, degrees.
pub(super) const LEAST_SCORE_GAIN: f64 = 0.3;
/// Places around such facets that are improved, at most: so many, and a share of the vertices.
pub(super) const MAX_POOR: usize = 20;
pub(super) const MAX_POOR_SHARE: f64 = 0.006;
/// Where the distance is this share of an edge, they stay: none of their neighbours may become as far.
pub(super) const POOR_FAR: f64 = 0.2;
/// Distance that is allowed there, share of an edge: on planes all distances are rounding.
pub(super) const POOR_DISTANCE: f64 = 1e-9;
/// Vertices whose valence is improved, at most.
pub(super) const MAX_IRREGULAR: usize = 500;
/// Rounds of the queue: some vertices have room for a flip only after far places were improved.
pub(super) const QUEUE_ROUNDS: usize = 2;
/// Flips that are tried at a far place. Flips that bring a facet nearest to the farthest point come first. Tried: 3 to all;
/// with 3 some results deviate more, and with all the time grows by a third without effect.
pub(super) const MAX_FLIPS: usize = 5;
/// Independent patches around irregular vertices that are made at the same time, at most. Far places are taken one by one,
/// since the budget is for the farthest: with four at once, results deviate by 6 % more.
pub(super) const PATCHES_AT_ONCE: usize = 64;
/// Places to search for independent patches.
pub(super) const LOOK_AHEAD: usize = 128;
/// Far places per thread to search for patches to make ahead.
pub(super) const FAR_LOOK_AHEAD: usize = 4;

// Attributes.

/// Least cosine between normals of coincident vertices that count as equal, despite the rounding of a file. So a smooth surface
/// whose triangles have vertices of their own, with normals of a few digits, has no seams.
pub(super) const SAME_NORMAL: f64 = 0.999;
/// Radius of the ball that bounds a walk, in half distances between its ends. Over a right-angled crease, 1 is enough.
pub(super) const SEAM_REACH: f64 = 1.3;
/// The radius for a second walk, if the first reached neither its end nor a seam, as around a thin edge of the surface.
pub(super) const LONG_SEAM_REACH: f64 = 4.0;
pub(super) const MAX_SEAM_FACETS: usize = 1 << 16;
/// An end is reached within this share of the distance between the ends.
pub(super) const SEAM_END_REACH: f64 = 1e-6;
/// Limit of extrapolation beyond a seam, as a multiple of the texture's stretch in the start facet.
pub(super) const MOST_STRETCH: f64 = 4.0;

// Deviation of the input and Hausdorff estimate.

/// Shares of a mean edge that decide, without a tolerance, which vertices of the input were missed. If a vertex is farther
/// away than the first share, all beyond the second share are missed.
pub(super) const MISSED_SHARES: [f64; 2] = [0.25, 0.17];
/// Radius that a sample covers, as a multiple of the square root of its area.
pub(super) const SAMPLE_REACH: f64 = 2.0;

// Tasks and checks. No result depends on them.

/// Work of a point whose nearest facet or sample is sought, as the token counts it.
pub(super) const WORK_PER_POINT: usize = 64;

// Curves to keep, and their envelope. Lengths are edge lengths of the result unless said otherwise.

/// Shortest crease with a free end. Shorter ones are noise of a scan, or folds that fade out.
pub(super) const SHORTEST_CREASE: f64 = 8.0;
/// Length over which bends of a curve are measured.
pub(super) const BEND_REACH: f64 = 1.0;
/// Distance from a weak ridge within which the surface must be smooth for the ridge to be a curve.
pub(super) const SMOOTH_REACH: f64 = 2.5;
/// Length of boundary below which two corners are merged, if the merge cuts off little. With both corners, a triangle
/// between them would have an angle of about as many radians.
pub(super) const JOINED_CORNERS: f64 = 0.4;
/// Largest distance of an edge from its boundary or crease.
pub(super) const BOUNDARY_LIMIT: f64 = 0.08;
pub(super) const CREASE_LIMIT: f64 = 0.06;
/// The same where regions or sheets end, whose areas are to stay: angles there are worse for it.
pub(super) const REGION_LIMIT: f64 = 0.02;
/// Largest distance of an edge from its curve where two curves meet at an acute angle: no facet there has a good one.
pub(super) const ACUTE_LIMIT: f64 = 0.3;
/// On a lifted surface, the edge by which the deviation of a curve from its chords is measured is no longer than this share of an even
/// edge. Edges are long where the surface is flat: with 1, the chords of the holes in a scan are farther off than any facet.
pub(super) const LIFTED_CHORD_EDGE: f64 = 0.6;
/// Largest share of the seeds for curves if there are creases. Boundaries alone may take all, as of a very narrow strip.
pub(super) const LARGEST_SHARE: f64 = 0.6;
/// Curves that need more seeds than this multiple of all seeds plus [`SPARE_SEEDS`] are dropped before any seed is placed, as
/// those of a strip as narrow as a hair. With less, a noisy surface with few points loses creases that there is room for.
pub(super) const MOST_SEEDS: usize = 16;
pub(super) const SPARE_SEEDS: usize = 1000;
/// How much longer or shorter edges may be on a surface that was divided along its creases than on one without, and how many lengths in
/// that range are tried at most.
pub(super) const MOST_CROWDED: f64 = 40.0;
pub(super) const CROWDED_STEPS: usize = 16;
/// Lengths whose ratio is less are the same, and a number of vertices of at least this share is what was asked for: a result has up to a
/// hundredth more or fewer in any case.
pub(super) const CROWDED_SAME: f64 = 1.001;
pub(super) const CROWDED_FULL: f64 = 0.997;
/// The next length to try is at least this share of the range away from both its ends.
pub(super) const CROWDED_AWAY: f64 = 0.05;
/// Dropped curves that are named, at most.
pub(super) const MOST_DROPPED_NAMED: usize = 8;
/// With fewer vertices than this share of those that were asked for, curves alone get more seeds.
pub(super) const CROWDED_ENOUGH: f64 = 0.98;
/// A surface is divided along its creases only if so much of the length of its edges is flat, as of designed parts: a flat or ruled face has
/// diagonals. Scans have none.
pub(super) const LEAST_FLAT: f64 = 0.1;
/// And so much of it is sharp: round faces made of few facets have flat diagonals as well.
pub(super) const LEAST_SHARP: f64 = 0.01;
/// Other random seeds that are tried where a designed part has few defects: that takes as long again, but few parts have any.
pub(super) const OTHER_SEEDS: u64 = 3;
/// Few defects, share of the facets: with more, points are too few, and other seeds do not help.
pub(super) const FEW_DEFECTS: f64 = 0.02;
/// With at most so many points, a designed part with defects gets these multiples of them until it has none. With more, points are not
/// what is lacking, and memory that was planned for them is not enough.
pub(super) const FEW_POINTS: usize = 2_500;
pub(super) const MORE_POINTS: [usize; 2] = [2, 4];
/// A curve is followed where an edge of the result that follows curves is nearer than this, edges.
pub(super) const CURVE_AWAY: f64 = 0.25;
/// Points are enough if no larger share of the length of curves is dropped or not followed, and no place of the input is so many edges
/// away. Threads whose creases are half an edge from the result are at 0.46 to 0.7, parts with all creases below 0.44.
pub(super) const ENOUGH_LACKING: f64 = 0.05;
pub(super) const ENOUGH_AWAY: f64 = 0.45;
/// A divided surface whose result has more crossing facets than this share was not to be divided.
pub(super) const MOST_CROSSING: f64 = 0.02;
/// A folded result that is farther from the input than this, shares of an edge, has no room for its curves.
pub(super) const FAR_DIVIDED: f64 = 0.25;
/// A patch whose mean width is less has no seeds within, edges.
pub(super) const NARROW_PATCH: f64 = 1.2;
/// Distance of other seeds from a curve's seeds, share of their spacing: about where the cells of the curve end. A larger
/// distance leaves too few seeds between two close curves, and no step takes a seed across a curve.
pub(super) const CLEARANCE: f64 = 0.5;
/// Share of spare points, as a divisor, since some points are too near to a curve.
pub(super) const SPARE_POINTS: usize = 50;
/// Least share of points that is assumed to be clear of the curves.
pub(super) const LEAST_CLEAR: f64 = 0.2;
/// A curve is straight at an edge if it leaves the edge's line by no more than this share of the edge. A curved one deviates
/// from its chords anyway; a straight one, such as the edge of a plate, shows any dent.
pub(super) const STRAIGHTNESS: f64 = 1e-3;
/// Edges to either side that have to be straight as well.
pub(super) const STRAIGHT_EDGES: usize = 3;

// Fit and its backtracking.

/// Rounds of the whole fit: each finds the nearest points anew.
pub(super) const FIT_ROUNDS: usize = 2;
/// Rounds that halve the moves of bad facets.
pub(super) const BACKTRACKING_HALVINGS: usize = 4;
/// Later rounds that drop the moves of bad facets.
pub(super) const BACKTRACKING_DROPS: usize = 4;

// The lift.

/// The shortest lift, as a share of the diagonal.
pub(super) const LEAST_LIFT: f64 = 1e-6;
/// The most that the length of the lift changes per distance: a slope stretches the lifted surface itself.
pub(super) const STEEPEST_LIFT: f64 = 0.3;
/// The same where vertices slide along the surface, since no fit makes up for cells that are less slender than they should be. With 0.3,
/// cells between the tips and the waist of an ellipsoid with axes 1 : 2 : 4 are half as slender, and the largest distance is 5 % more.
/// With 1, a fit has other largest distances, no smaller ones, and parts with creases take half as long again.
pub(super) const STEEPEST_SLIDING_LIFT: f64 = 1.0;
/// Rounds in which normals are smoothed, at most.
pub(super) const MOST_SMOOTHING_ROUNDS: f64 = 16.0;

// Slender facets.

/// Rounds with a shorter lift where cells fail, at most; by how much it is shorter after the first, and by the square of it after
/// the second and so on; and quasi-Newton steps in a round.
pub(super) const MAX_FOLD_ROUNDS: usize = 5;
pub(super) const FOLD_SHORTER: f64 = 0.5;
pub(super) const FOLD_STEPS: usize = 8;
/// Score and largest angle of a facet, degrees, beyond which the fit makes none worse: an equilateral triangle that is stretched
/// to eight times its height has 12 and 156 degrees, and corners may be nearer to one another than the ideal.
pub(super) const SLENDER_SCORE: f64 = 5.0;
pub(super) const SLENDER_ANGLE: f64 = 165.0;
/// Share of the damping and the stiffness of the fit. Slender facets may slide to where they are nearer. Tried: 0.01 to 1. With 0.1
/// the RMS distance is a tenth less, but facets begin to cross in thin parts; with 1 it is a tenth more.
pub(super) const SLENDER_DAMPING: f64 = 0.3;
/// Where the largest distances count: the power of squared residuals in the weights of least squares, 4 for the norm of power 10, the
/// most that a weight is off 1, and the rounds of a fit.
pub(super) const LARGEST_POWER: i32 = 4;
pub(super) const LARGEST_WEIGHT: f64 = 1000.0;
pub(super) const LARGEST_ROUNDS: usize = 4;
/// Rounds in which vertices are moved to as far from the input on either side, and the share of the way in each.
pub(super) const BALANCING_ROUNDS: usize = 8;
pub(super) const BALANCING_SHARE: f64 = 0.5;
/// Steps in which vertices slide along the surface, and after how many of them edges are flipped. 30 steps gain nothing more.
pub(super) const SLIDING_STEPS: usize = 20;
pub(super) const SLIDING_STEPS_PER_FLIP: usize = 7;
/// The power of squared distances by which facets draw their corners. Tried: 4 to 40. With 8 the largest distance is 4 % more.
pub(super) const SLIDING_POWER: i32 = 24;
/// The share of the way that a vertex goes in a step, and of its last step that it makes again. With shares of 0.05 and more, vertices swing.
pub(super) const SLIDING_SHARE: f64 = 0.03;
pub(super) const SLIDING_MOMENTUM: f64 = 0.6;
/// Rounds of flips, each with a fit after it.
pub(super) const SLENDER_ROUNDS: usize = 3;
/// Rounds that take crossing facets back, half of the way each and the rest in the last.
pub(super) const UNCROSSING_ROUNDS: usize = 5;
/// Passes of flips at facets that face away from the surface, and the valences that they keep.
pub(super) const UNFOLDING_ROUNDS: usize = 4;
pub(super) const UNFOLDING_VALENCES: [usize; 2] = [3, 12];
/// Passes of flips in a round, at most: few edges are flipped after the fifth.
pub(super) const FLIPPING_ROUNDS: usize = 10;
/// Valences of inner vertices that such flips keep.
pub(super) const FLIPPING_VALENCES: [usize; 2] = [4, 9];
/// Share of the sum of squared distances that a flip must leave, at most: rounding gains nothing.
pub(super) const FLIPPING_SHARE: f64 = 0.999;
/// Distance of a sample, edge lengths, from which on a flip is of use.
pub(super) const FLIPPING_DISTANCE: f64 = 1e-3;

// Normal equations of the fit.

/// Steps of conjugate gradients in a round. A move spreads by one facet a step.
pub(super) const GRADIENT_STEPS: usize = 14;
/// The steps end at this share of the first squared residual (r·z).
pub(super) const RESIDUAL_SHARE: f64 = 1e-8;
/// Weight of a move in the tangent plane beside a residual of the same length, so that a vertex does not slide. Tried: 0.01
/// to 0.05; 0.05 leaves 4 % more RMS distance, 0.01 costs 0.002 of mean quality.
pub(super) const TANGENT_DAMPING: f64 = 0.02;
/// Weight of the difference between the moves of neighbours, so that neighbours move together.
pub(super) const STIFFNESS: f64 = 0.02;
/// Weight of a move along the normal. It keeps the system regular where samples are few.
pub(super) const NORMAL_DAMPING: f64 = 0.01;
/// Weight of a residual of a curve beside one of the surface: the eye follows curves.
pub(super) const CURVE_WEIGHT: f64 = 20.0;
/// Vertices of a run. Sums are those of the runs, so another number gives other bits.
pub(super) const VERTICES_PER_RUN: usize = 256;

// Boundary ears.

/// Smallest angle of an ear, degrees. Below it, the boundary is already near the missing edge: within a tenth of its length.
pub(super) const LEAST_EAR_ANGLE: f64 = 12.0;
/// The least cosine between the normals of an ear and of its neighbours.
pub(super) const LEAST_EAR_COSINE: f64 = 0.5;

// Manifold repair.

/// Share of the way to the centroids of its facets by which a copy of a split vertex moves.
pub(super) const STEP_BACK: f64 = 1.0 / 16.0;
/// Share of its shortest edge by which a vertex moves along its normal to leave another one.
pub(super) const SIDE_STEP: f64 = 1e-3;

// Rounds of an attempt, and extraction.

/// Rounds that add seeds, where a tolerance was given.
pub(super) const ADDING_ROUNDS: usize = 8;
/// Rounds that move seeds which produced no vertex.
pub(super) const MOVING_ROUNDS: usize = 1;
/// Growth of the deviation up to which a round that adds seeds counts as better, though a place may be worse.
pub(super) const ADDING_SLACK: f64 = 2.0;
/// Growth of the deviation up to which a round counts as better if fewer seeds have no vertex.
pub(super) const MOVING_SLACK: f64 = 1.25;
/// Share of the tolerance by which a vertex may leave its curve: the chords between such vertices are off as well.
pub(super) const OFF_CURVE_SHARE: f64 = 0.5;

// Regions.

/// Share of a piece between curves that votes for one region where it is all of it. The rest is rounding at its borders.
pub(super) const ONE_REGION_SHARE: f64 = 0.9;

// Sheets apart.

/// Boundaries that are nearer to each other than this are a gap, share of the diagonal.
pub(super) const MOST_GAP_DIAGONAL: f64 = 1e-3;
/// Distances that are tried for the one that closes all gaps: the first is the widest gap, each other is as many times the last. A
/// vertex moves to another, so that a distance along an edge counts too.
pub(super) const WELD_GROWTH: f64 = 1.4;
pub(super) const WELD_STEPS: usize = 8;
/// Distances in a row that close no more edges, which end the tries.
pub(super) const WELD_STEPS_IN_VAIN: usize = 2;
/// Distance between sheets, edge lengths; [`SEPARATION_DIAGONAL`] is added to it.
pub(super) const SEPARATION_EDGES: f64 = 2.0;
/// Distance between sheets, share of the diagonal.
pub(super) const SEPARATION_DIAGONAL: f64 = 0.02;
/// Points that a sheet needs: a tetrahedron has four vertices.
pub(super) const POINTS_PER_COMPONENT: usize = 4;

// Schedule of steps.

/// Rounds that push seeds off curves after the last step. In the last one the curves adopt the seeds instead.
pub(super) const CLEARING_ROUNDS: usize = 2;
/// Steps after such a round.
pub(super) const CLEARING_STEPS: usize = 3;
/// Steps after seeds were moved or added.
pub(super) const REFINING_STEPS: usize = 6;

// Thin parts.

/// Rounds that draw seeds again, at most.
pub(super) const MAX_THIN_ROUNDS: usize = 6;
/// Rounds without a better result, at most: with other seeds, other cells may fail.
pub(super) const MAX_VAIN_ROUNDS: usize = 3;
/// Factor on edge lengths at failing cells in a round: twice as many cells around what one cell reached around.
pub(super) const THIN_SHORTER: f64 = 0.5;
/// Factor by which the median edge may grow for it: half of the points may go to thin parts.
pub(super) const THIN_LONGEST: f64 = 1.4;
/// Rounds with shorter edges where facets cross, at most; the factor on lengths in a round: chords leave a bent sheet by half as much; and
/// how far from a facet edges become shorter, longest sides of it.
pub(super) const MAX_CROSSING_ROUNDS: usize = 3;
pub(super) const CROSSING_SHORTER: f64 = std::f64::consts::FRAC_1_SQRT_2;
pub(super) const CROSSING_REACH: f64 = 1.0;
/// Rounds in which edges of facets that still cross are divided, at most; vertices that it takes, share of all; and how many more it may
/// take if none cross then.
pub(super) const DIVIDING_ROUNDS: usize = 6;
pub(super) const MOST_DIVIDED: f64 = 0.01;
pub(super) const MOST_DIVIDED_FOR_ALL: f64 = 0.1;
/// Places this near to a plane are in it, share of the longest edge there: rounding is less, and no distance shows it.
pub(super) const IN_PLANE: f64 = 1e-6;
/// Edges around a bore or a pin of a part that is divided, in its radii: about eight go around. Bends with a smaller radius than the
/// second, in edges, are left to patches without vertices within; no edge is shorter than the third, in edges.
pub(super) const BEND_EDGE: f64 = 0.8;
pub(super) const LEAST_BEND: f64 = 0.25;
pub(super) const SHORTEST_BEND_EDGE: f64 = 0.5;
/// A wall is sought so far behind a bent skin, in edges: one of twice this thickness is found. Edges along it, in roots of radius times
/// thickness: chords as long as 2 of these, on both skins, would meet in the middle.
pub(super) const THIN_WALL: f64 = 0.25;
pub(super) const BENT_WALL: f64 = 1.4;
/// A bend turns back if the surface is this near to where the circle is opposite, in radii, and faces the other way, cosine.
pub(super) const BEND_OFF: f64 = 0.3;
pub(super) const BEND_FACING: f64 = 0.5;
/// A part with creases is divided along them if cells in several pieces would give it so many vertices, times the number asked for. Fewer
/// seeds cost less for what is left.
pub(super) const DIVIDED_ABOVE: f64 = 1.1;
/// Factor by which the number of points may grow where edge lengths imply it.
pub(super) const THIN_MOST_POINTS: usize = 2;

// Number of vertices.

/// Relative and absolute error of the number of vertices that is accepted: the larger one.
pub(super) const COUNT_LIMIT: f64 = 0.015;
pub(super) const COUNT_SLACK: usize = 2;
/// Least number of vertices that a further seed is expected to add; two rounds may differ by chance.
pub(super) const LEAST_SLOPE: f64 = 0.7;
/// Factor on the change of the number of seeds after a round without progress.
pub(super) const VAIN_STRETCH: f64 = 1.5;
/// Rounds that draw fewer seeds, at most.
pub(super) const MAX_COUNT_ROUNDS: usize = 4;
/// Least number of seeds, share of the requested vertices.
pub(super) const FEWEST_SEEDS_SHARE: f64 = 0.1;
/// Most seeds, times the vertices that were asked for, where sheets are joined: many have copies of one curve.
pub(super) const MOST_SEEDS_OF_JOINED: f64 = 3.0;
/// Least number of seeds: the vertices of a tetrahedron.
pub(super) const FEWEST_SEEDS: f64 = 4.0;

// Refinement to a tolerance.

/// Rounds with shorter edges, at most.
pub(super) const MAX_REFINING_ROUNDS: usize = 9;
/// Rounds that shorten edges only where the result is too far. Later rounds use up the points by the last round.
pub(super) const LOCAL_ROUNDS: usize = 6;
/// Rounds in a row without progress, at most. In the second one, all edges are shorter.
pub(super) const MAX_VAIN_REFINING: usize = 2;
/// Factor on the number of points in a round after one without progress.
pub(super) const VAIN_GROWTH: f64 = 2.0;
/// A largest distance below this share of the least one so far is progress.
pub(super) const PROGRESS_SHARE: f64 = 0.95;
/// A share of missed samples below this share of the least one so far is progress.
pub(super) const FEWER_MISSED: f64 = 0.8;
/// Share of the tolerance that shortened edges aim at: the largest distances are half as large again as the mean.
pub(super) const TOLERANCE_AIM: f64 = 0.7;
/// Least factor on an edge's length in one round. At a crease that was not kept, distance is proportional to length.
pub(super) const SHORTEST_SHARE: f64 = 0.35;
/// Area over tolerance, diagonal and this is the number of points that a search for a tolerance begins with: equilateral facets deviate by
/// a sixth of their squared edges over the radius of curvature, and a fourth of the diagonal is an ordinary radius.
pub(super) const FIRST_POINTS_AREA: f64 = 1.3;
pub(super) const LEAST_FIRST_POINTS: usize = 300;
/// Rounds with longer edges, at most, once the tolerance is met.
pub(super) const MAX_LENGTHENING_ROUNDS: usize = 10;
/// Largest factor on an edge's length in one of them.
pub(super) const LONGEST_SHARE: f64 = 2.0;
/// Share of the points that one of them saves at least if the next is to go as far.
pub(super) const LEAST_SAVED: f64 = 0.05;
/// Factor on all lengths once no others save points: about 7 % fewer points.
pub(super) const EVEN_GROWTH: f64 = 1.04;
/// Least share of the way to the lengths sought that is still tried.
pub(super) const LEAST_PACE: f64 = 0.2;
/// Share of missed samples up to which seeds are added there after the last round.
pub(super) const FEW_MISSED_SHARE: f64 = 0.002;
/// Share of the allowed points from which on they count as used up.
pub(super) const SPENT_SHARE: f64 = 0.95;
/// Times that seeds are added to given ones, each to come nearer.
pub(super) const MAX_ADDING_TIMES: usize = 3;

// Rounding.

/// Lengths below this are only rounding, in the unit frame and beside unit vectors. A point of a flat input is in two facets of
/// the result, a seed is at a vertex, and normals of a plate's two sides cancel half-way between them on its rim.
pub(super) const ROUNDING: f64 = 1e-9;
pub(super) const ROUNDING_SQUARED: f64 = ROUNDING * ROUNDING;
/// Factor on bounds of angles and distances. Values nearer to the bound are left to the exact computation.
pub(super) const BOUND_ROUNDING: f64 = 1.0 - ROUNDING;
/// Factor on the radius of a search, so that rounding loses nothing.
pub(super) const RADIUS_ROUNDING: f64 = 1.0 + ROUNDING;
/// Squares below this share of a squared bound have roots below the bound despite rounding.
pub(super) const SQUARE_ROUNDING: f64 = 1.0 - 1e-12;

// Unit edges in a metric. Lengths are those of the metric.

/// An edge longer than this is split, and a shorter one than this collapsed.
pub(super) const SPLIT_LENGTH: f64 = std::f64::consts::SQRT_2;
pub(super) const COLLAPSE_LENGTH: f64 = std::f64::consts::FRAC_1_SQRT_2;
/// The longest edge that a collapse may make.
pub(super) const LONGEST_NEW: f64 = SPLIT_LENGTH;
/// The shortest edge from the new vertex of a split to the facets' third corners, unless the edge is longer than the second.
pub(super) const SHORTEST_NEW: f64 = 0.55;
pub(super) const FAR_TOO_LONG: f64 = 1.7;
/// A collapse makes no facet with a shape below this, unless there was a worse one.
pub(super) const POOR_QUALITY: f64 = 0.3;
/// Least cosine between a facet's normal and that of the input, unless it was less before.
pub(super) const FACING_COSINE: f64 = 0.5;
/// The shortest edge that is split because a facet beside it does not face so.
pub(super) const LEAST_ASTRAY: f64 = 0.1;
/// Least cosine between a facet's normals before and after one move.
pub(super) const TURNED_COSINE: f64 = 0.2;
/// Least gain of the worse facet's shape by a flip.
pub(super) const LEAST_FLIP_GAIN: f64 = 1e-3;
/// Least and largest valence that flips make. In a metric that changes fast, many edges meet.
pub(super) const METRIC_VALENCES: [usize; 2] = [4, 12];
pub(super) const METRIC_FLIPPING_PASSES: usize = 10;
/// Cost of a facet with shape 0, where an edge that is e times too long costs 1.
pub(super) const SHAPE_WEIGHT: f64 = 0.5;
/// Least gain of a move, cost.
pub(super) const LEAST_MOVE_GAIN: f64 = 1e-4;
/// Shares of its step that a vertex tries.
pub(super) const MOVE_SHARES: [f64; 3] = [1.0, 0.5, 0.25];
/// An edge shorter than this pushes as one of this length.
pub(super) const SHORTEST_PULLED: f64 = 0.3;
pub(super) const RELOCATION_PASSES: usize = 6;
/// Rounds at most.
pub(super) const ADAPTING_ROUNDS: usize = 30;
/// Rounds end when fewer splits and collapses than this share of the vertices were made.
pub(super) const SETTLED_SHARE: f64 = 0.002;
/// The most vertices, in those of the draft, and more of them for a coarse draft. A metric that is noise would take many times as many.
pub(super) const MOST_GROWTH: usize = 4;
pub(super) const SPARE_VERTICES: usize = 1000;
/// Vertices for an area of 1 in the metric: 2/√3 of equilateral triangles, times 1.09, since the rounds leave edges of 0.96 in the mean.
/// From 1.00, where the metric is nearly the same in all directions, to 1.12 at ten times as long edges was measured.
pub(super) const VERTICES_PER_AREA: f64 = 1.26;
/// Times that the metric is scaled again for a number of vertices, at most, and how far off that number may be.
pub(super) const SCALING_TIMES: usize = 4;
pub(super) const SCALING_TOLERANCE: f64 = 0.01;

// Parts that stay.

/// A vertex is that of a corner's seed if it is this near, unit frame: the frame's transformation rounds.
pub(super) const CORNER_ROUNDING: f64 = 1e-12;
/// A facet between those that stay has no room for a vertex if its area is below this, cells: a regular triangle of twice the target
/// edge has two.
pub(super) const ENCLOSED_CELLS: f64 = 2.0;
/// Rounds in which facets beside these stay too, at most; each reaches one facet farther than the last.
pub(super) const FURTHER_KEPT_ROUNDS: usize = 6;
/// Vertices around one that is taken out of an edge, at most.
pub(super) const MOST_AROUND_TAKEN: usize = 64;
/// Least cosine between a facet and those whose place it takes there.
pub(super) const TAKEN_COSINE: f64 = 0.1;

// Symmetry and periods.

/// Vertices as near to a mirror plane are in it, and boundaries as near to the images of others are these; share of the diagonal. Files
/// with six digits round by half of this.
pub(super) const MATCH_DIAGONAL: f64 = 1e-6;
/// Times that a half is remeshed again for a number of vertices of the whole.
pub(super) const HALF_COUNT_ROUNDS: usize = 2;
/// Vertices between the ends of an edge that a boundary lacks, at most.
pub(super) const MOST_IN_NOTCH: usize = 4;
/// A vertex at which the ends of such an edge are seen under a wider angle is taken out instead: cosine of 135°.
pub(super) const WIDEST_NOTCH_COSINE: f64 = -0.707;
