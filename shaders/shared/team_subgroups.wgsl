// A team is a part of a subgroup whose lanes work on one particle. A workgroup contains TEAMS
// teams. Butterfly sums add the same two numbers in both lanes of a pair, so every lane gets the
// same bits. TEAM is a power of two.

// Returns the sum over the lanes of the team. Every lane gets the same bits.
fn team_sum(value: vec4<f32>, lane: u32) -> vec4<f32> {
    var sum = value;
    for (var step = TEAM / 2u; step > 0u; step >>= 1u) {
        sum += subgroupShuffleXor(sum, step);
    }
    return sum;
}

// Returns the value with the largest x among the lanes of the team. If several have the same x, the
// value with the smallest y is returned. Every lane gets the same result.
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
