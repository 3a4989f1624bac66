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
