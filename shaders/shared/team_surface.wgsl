// Evaluates F with a team of lanes. The lanes share the 64 taps. The sum is unrolled for the reason
// given at two_taps.

// Returns the gradient of F per mm (xyz) and F in mm (w).
fn surface_at(position: vec3<f32>, lane: u32) -> vec4<f32> {
    let cell = cell_at(position);
    open_cell(cell);
    let plane = lane & 15u;
    var sum = vec4(0.0);
    if TEAM == 32u {
        sum = two_taps(cell, plane, 2u * (lane >> 4u));
    } else {
        sum = four_taps(cell, plane);
        if TEAM <= 8u {
            sum += four_taps(cell, plane + 8u);
        }
        if TEAM <= 4u {
            sum += four_taps(cell, plane + 4u) + four_taps(cell, plane + 12u);
        }
    }
    sum = team_sum(sum, lane);
    return vec4(sum.xyz * parameters.inverse_spacing, sum.w);
}
