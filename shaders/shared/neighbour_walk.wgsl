// Visits the neighbours of a particle in a fixed order: by level, then bin, then index. Each kernel
// that includes this file defines `found`, which is called for each neighbour.
//
// Twin: `visit` in common/field/src/neighbours/bins.rs

@group(0) @binding(5) var<storage, read> bin_starts: array<u32>;
@group(0) @binding(8) var<storage, read> place: array<vec4<f32>>;
@group(0) @binding(9) var<storage, read> normal: array<vec4<f32>>;

// Calls found(n, j) for the n-th neighbour j of particle i and returns the number of neighbours. A
// neighbour is a particle that interacts with i and is closer than SUPPORT (1 + SKIN) min(h_i,
// h_j).
fn walk_neighbours(i: u32) -> u32 {
    let own = place[i];
    let facing = normal[i];
    let reach = SUPPORT * (1.0 + SKIN);
    var count = 0u;
    for (var level = 0u; level < parameters.level_count; level++) {
        // a bin edge is at least this radius, so the query covers at most 3 bins along each axis;
        // the factor allows for rounding
        let radius = 1.00001 * reach * min(own.w, parameters.levels[level].largest);
        let low = bin_coordinate(own.xyz - radius, level);
        let high = bin_coordinate(own.xyz + radius, level);
        for (var z = low.z; z <= high.z; z++) {
            for (var y = low.y; y <= high.y; y++) {
                let first = bin_starts[bin_number(vec3(low.x, y, z), level)];
                let end = bin_starts[bin_number(vec3(high.x, y, z), level) + 1u];
                for (var j = first; j < end; j++) {
                    let other = place[j];
                    let offset = own.xyz - other.xyz;
                    let limit = reach * min(own.w, other.w);
                    if j != i && dot(offset, offset) < limit * limit && see_each_other(facing, normal[j]) {
                        found(count, j);
                        count++;
                    }
                }
            }
        }
    }
    return count;
}
