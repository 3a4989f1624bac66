// A team of lanes of one subgroup works for one particle; a workgroup is TEAMS of them. Sums go by butterfly, in which each
// step adds the same two numbers in both lanes, so that every lane ends with the same bits. TEAM is a power of two.

// The sum over the team's lanes, the same bits in each.
fn team_sum(value: vec4<f32>, lane: u32) -> vec4<f32> {
    var sum = value;
    for (var step = TEAM / 2u; step > 0u; step >>= 1u) {
        sum += subgroupShuffleXor(sum, step);
    }
    return sum;
}

// Of the team's values that of the largest x, and of these that of the least y; the same bits in each lane.
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
