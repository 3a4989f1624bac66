// Levels of bins, one for each octave of h. A query visits at most 27 bins on each level, however
// strongly h is graded. With the paper's single bin edge max(h), bins in fine regions are overfull.
//
// Twin: `LevelBins` in common/field/src/neighbours/bins.rs

// The finest level that holds particles of size h.
fn level_of(h: f32) -> u32 {
    var level = 0u;
    for (var k = 1u; k < parameters.level_count; k++) {
        level += select(0u, 1u, h <= parameters.levels[k].largest);
    }
    return level;
}

// The bin that contains a position, clamped to the level.
fn bin_coordinate(position: vec3<f32>, level: u32) -> vec3<i32> {
    let relative = (position - parameters.bins_origin) * parameters.levels[level].inverse_edge;
    return clamp(vec3<i32>(floor(relative)), vec3(0), vec3<i32>(parameters.levels[level].bins) - 1);
}

// The number of a bin in the order of all levels, x fastest.
fn bin_number(at: vec3<i32>, level: u32) -> u32 {
    let bins = parameters.levels[level].bins;
    return parameters.levels[level].first_bin + (u32(at.z) * bins.y + u32(at.y)) * bins.x + u32(at.x);
}
