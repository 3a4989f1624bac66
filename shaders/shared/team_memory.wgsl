// A team of TEAM lanes, a workgroup, works for one particle. Sums go through workgroup memory in a fixed order: for adapters without
// subgroups of 32.

var<workgroup> team_scratch: array<vec4<f32>, TEAM>;

// The sum over the team's lanes, the same bits in each.
fn team_sum(value: vec4<f32>, lane: u32) -> vec4<f32> {
    workgroupBarrier();
    team_scratch[lane] = value;
    workgroupBarrier();
    var sum = vec4(0.0);
    for (var other = 0u; other < TEAM; other++) {
        sum += team_scratch[other];
    }
    return sum;
}

// Of the team's values that of the largest x, and of these that of the least y; the same bits in each lane.
fn team_best(value: vec4<f32>, lane: u32) -> vec4<f32> {
    workgroupBarrier();
    team_scratch[lane] = value;
    workgroupBarrier();
    var best = team_scratch[0];
    for (var other = 1u; other < TEAM; other++) {
        let next = team_scratch[other];
        best = select(best, next, next.x > best.x || (next.x == best.x && next.y < best.y));
    }
    return best;
}
