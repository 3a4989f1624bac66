// A team consists of TEAM consecutive lanes of a subgroup that work on one particle. TEAM is a
// power of two, and a workgroup contains TEAMS teams. A butterfly sum adds the same two numbers in
// both lanes of a pair, so the result is bitwise identical in all lanes.

// Returns the sum over the lanes of the team. The result is bitwise identical in all lanes.
fn team_sum(value: vec4<f32>, lane: u32) -> vec4<f32> {
    var sum = value;
    for (var step = TEAM / 2u; step > 0u; step >>= 1u) {
        sum += subgroupShuffleXor(sum, step);
    }
    return sum;
}

// Returns the value with the largest x among the lanes of the team. Ties go to the smallest y.
// Every lane gets the same result.
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
