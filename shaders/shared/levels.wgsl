// Levels of bins, one for each octave of h. A query visits at most 27 bins on each level, however
// strongly h is graded. With a single bin edge of max(h), as in the paper, bins in fine regions
// would contain too many particles.
//
// Twin: `LevelBins` in common/field/src/neighbours/bins.rs

// Returns the finest level whose maximum h is at least `h`, or level 0 if there is none.
fn level_of(h: f32) -> u32 {
    var level = 0u;
    for (var k = 1u; k < parameters.level_count; k++) {
        level += select(0u, 1u, h <= parameters.levels[k].largest);
    }
    return level;
}

// Returns the coordinates of the bin that contains a position, clamped to the level.
fn bin_coordinate(position: vec3<f32>, level: u32) -> vec3<i32> {
    let relative = (position - parameters.bins_origin) * parameters.levels[level].inverse_edge;
    return clamp(vec3<i32>(floor(relative)), vec3(0), vec3<i32>(parameters.levels[level].bins) - 1);
}

// Returns the index of a bin among the bins of all levels, with x varying fastest.
fn bin_number(at: vec3<i32>, level: u32) -> u32 {
    let bins = parameters.levels[level].bins;
    return parameters.levels[level].first_bin + (u32(at.z) * bins.y + u32(at.y)) * bins.x + u32(at.x);
}
