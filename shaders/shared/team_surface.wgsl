// F by a team: the 64 taps are spread over its lanes, without loops (see two_taps).

// The gradient of F (xyz, per mm) and F (w, mm).
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
