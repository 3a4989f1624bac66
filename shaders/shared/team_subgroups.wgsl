// A team is a part of a subgroup that works for one particle; a workgroup holds TEAMS of them.
// Butterfly sums add the same two numbers in both lanes of a pair, so every lane gets the same
// bits. TEAM is a power of two.

// The sum over the team's lanes, with the same bits in each lane.
fn team_sum(value: vec4<f32>, lane: u32) -> vec4<f32> {
    var sum = value;
    for (var step = TEAM / 2u; step > 0u; step >>= 1u) {
        sum += subgroupShuffleXor(sum, step);
    }
    return sum;
}

// The team's value with the largest x, and of equal ones the smallest y; the same in each lane.
fn team_best(value: vec4<f32>, lane: u32) -> vec4<f32> {
    var best = value;
    for (var step = TEAM / 2u; step > 0u; step >>= 1u) {
        best = better(best, subgroupShuffleXor(best, step));
    }
    return best;
}

fn better(a: vec4<f32>, b: vec4<f32>) -> vec4<f32> {
    return select(a, b, b.x > a.x || (b.x == a.x && b.y < a.y));
}
