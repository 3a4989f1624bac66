// Damped Newton step in the tangent plane (Eq. 3).
//
// Twin: `positive_definite`, `damped_newton` in stages/particles/src/movement.rs

// Replaces the eigenvalues of a symmetric 2 x 2 matrix (entries uu, uv, vv) with their magnitudes
// and bounds them away from zero. The Newton step then points in a descent direction.
fn positive_definite(m: vec3<f32>) -> vec3<f32> {
    let middle_of = 0.5 * (m.x + m.z);
    let half_gap = 0.5 * (m.x - m.z);
    let half = sqrt(half_gap * half_gap + m.y * m.y);
    let low = abs(middle_of - half);
    let high = abs(middle_of + half);
    let bound = EIGENVALUE_FLOOR * max(low, high);
    let l = max(low, bound);
    let h = max(high, bound);
    if half <= EQUAL_EIGENVALUES_F32 * abs(middle_of) {
        return vec3(l, 0.0, l);
    }
    let middle = 0.5 * (l + h);
    let spread = 0.5 * (h - l);
    return vec3(middle + spread * half_gap / half, spread * m.y / half, middle - spread * half_gap / half);
}

// Solves (H + lambda diag H) x = -g.
fn damped_newton(h: vec3<f32>, g: vec2<f32>, lambda: f32) -> vec2<f32> {
    let a = h.x * (1.0 + lambda);
    let c = h.z * (1.0 + lambda);
    let determinant = a * c - h.y * h.y;
    return vec2(-(c * g.x - h.y * g.y), -(a * g.y - h.y * g.x)) / determinant;
}
