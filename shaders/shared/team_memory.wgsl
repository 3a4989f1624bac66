// A team of 32 lanes works for one particle. Sums go through workgroup memory in a fixed order: for adapters without
// subgroups of 32.

const TEAM: u32 = 32u;
const TEAMS: u32 = 1u;

var<workgroup> team_scratch: array<vec4<f32>, 32>;

// The sum over the team's lanes, the same bits in each.
fn team_sum(value: vec4<f32>, lane: u32) -> vec4<f32> {
    workgroupBarrier();
    team_scratch[lane] = value;
    workgroupBarrier();
    var sum = vec4(0.0);
    for (var other = 0u; other < 32u; other++) {
        sum += team_scratch[other];
    }
    return sum;
}
