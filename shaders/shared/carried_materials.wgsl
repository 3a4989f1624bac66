// In a multi-material run, normal.w stores 16 s + c, where s is the index of the particle's
// stratum. The code c is log10(damping / 0.001), or HELD_CODE for a held particle. The value is an
// integer below 2^24, so f32 represents it exactly. The material interfaces have the lowest
// indices. Each held particle has a separate index, above the indices of the interfaces.
//
// Twin: `rebuild_lists` in stages/particles/src/state.rs

// Index of strata and coefficients. stages/particles/src/gpu/differences.rs builds it and documents
// its layout.
@group(0) @binding(28) var<storage, read> materials_index: array<vec4<u32>>;

fn damping_of(carried: f32) -> f32 {
    var damping = LEAST_LAMBDA;
    for (var power = u32(carried) & 15u; power > 0u; power--) {
        damping *= LAMBDA_GROWTH;
    }
    return damping;
}

fn with_damping(carried: f32, damping: f32) -> f32 {
    let power = u32(floor(log2(damping / LEAST_LAMBDA) / log2(LAMBDA_GROWTH) + 0.5));
    return f32((u32(carried) & ~15u) | min(power, HELD_CODE - 1u));
}

fn is_held(carried: f32) -> bool {
    return (u32(carried) & 15u) == HELD_CODE;
}

// Returns the materials of a particle's stratum in ascending order, padded with 65535.
fn materials_of(carried: f32) -> vec4<u32> {
    return materials_index[materials_index[0].x + (u32(carried) >> 4u)];
}

// Returns whether a junction stratum (`lower`) lies on the interface of the materials pair.x and
// pair.y.
fn is_on(lower: vec4<u32>, pair: vec4<u32>) -> bool {
    return any(lower == vec4(pair.x)) && any(lower == vec4(pair.y));
}

// Returns whether two particles interact. A held particle interacts with all particles of the
// interfaces that meet at its junction, regardless of their normals. Two held particles do not
// interact.
fn see_each_other(a: vec4<f32>, b: vec4<f32>) -> bool {
    if is_held(a.w) {
        return !is_held(b.w) && is_on(materials_of(a.w), materials_of(b.w));
    }
    if is_held(b.w) {
        return is_on(materials_of(b.w), materials_of(a.w));
    }
    return (u32(a.w) >> 4u) == (u32(b.w) >> 4u) && dot(a.xyz, b.xyz) > parameters.normal_agreement;
}
