// What goes with a particle of many materials beside its normal (normal.w): 16 times the number of its stratum, and the power of ten of its
// damping from 0.001 on, or HELD_CODE. A whole number below 2^24, so that f32 holds it exactly. Strata of particles that are held are numbered behind the sheets, one each.
//
// Twin: `rebuild_lists` in stages/particles/src/state.rs

// Made by stages/particles/src/gpu/differences.rs, which says what is where.
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

// The materials of a particle's stratum, ascending; 65535 behind the last.
fn materials_of(carried: f32) -> vec4<u32> {
    return materials_index[materials_index[0].x + (u32(carried) >> 4u)];
}

fn is_on(lower: vec4<u32>, sheet: vec4<u32>) -> bool {
    return any(lower == vec4(sheet.x)) && any(lower == vec4(sheet.y));
}

fn see_each_other(a: vec4<f32>, b: vec4<f32>) -> bool {
    if is_held(a.w) {
        return !is_held(b.w) && is_on(materials_of(a.w), materials_of(b.w));
    }
    if is_held(b.w) {
        return is_on(materials_of(b.w), materials_of(a.w));
    }
    return (u32(a.w) >> 4u) == (u32(b.w) >> 4u) && dot(a.xyz, b.xyz) > parameters.normal_agreement;
}
