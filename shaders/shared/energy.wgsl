// Energy of a pair of particles (Eq. 1 and 2). The sums over neighbours (Eq. 4) are in
// team_energy.wgsl.
//
// With the scaled distance d, x = d pi/2 and c = cot x, the energy is c + x - pi/2. Its first
// derivative with respect to d is -(pi/2) c^2, and the second is (pi^2/2) c (1 + c^2). Sine and
// cosine are evaluated as polynomials because WGSL guarantees only 11 bits of accuracy for the
// built-in functions, and their results differ between adapters.
//
// Twin: `pair_energy`, `scaled_distance` in common/field/src/energy.rs

// Returns sin x for 0 <= x <= pi/2 with a relative error below 1e-7.
fn sine(x: f32) -> f32 {
    let s = x * x;
    return x * (1.0 + s * (-0.16666667 + s * (0.0083333333 + s * (-0.00019841270 + s * (2.7557319e-6 + s * -2.5052108e-8)))));
}

// Returns cot(d pi/2) for 0 < d <= 1.
fn cotangent(d: f32) -> f32 {
    return sine(FRAC_PI_2 * (1.0 - d)) / sine(FRAC_PI_2 * d);
}

// Returns the energy of Eq. 1, which is 0 for d >= 1.
fn pair_energy(d: f32) -> f32 {
    if d >= 1.0 {
        return 0.0;
    }
    let safe = max(d, LEAST_SCALED_DISTANCE);
    return max(cotangent(safe) - FRAC_PI_2 * (1.0 - safe), 0.0);
}

// Returns the energy of two particles that are separated by `offset` and have target edge lengths
// `h` and `other`.
fn energy_between(offset: vec3<f32>, h: f32, other: f32) -> f32 {
    return pair_energy(length(offset) / (SUPPORT * min(h, other)));
}
