// A team is a workgroup of TEAM lanes that work on one particle. Sums are computed in workgroup
// memory in a fixed order. This variant is for adapters without subgroups, or with subgroups of
// fewer than 32 lanes.

var<workgroup> team_scratch: array<vec4<f32>, TEAM>;

// Returns the sum over the lanes of the team. The result is bitwise identical in all lanes.
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

// Returns the value with the largest x among the lanes of the team. Ties go to the smallest y.
// Every lane gets the same result.
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
