// F by one invocation.

// The gradient of F (xyz, per mm) and F (w). Of no use here: `lane`, which the other piece of this name needs.
fn surface_at(position: vec3<f32>, lane: u32) -> vec4<f32> {
    let cell = cell_at(position);
    open_cell(cell);
    var sum = vec4(0.0);
    for (var plane = 0u; plane < 16u; plane++) {
        sum += four_taps(cell, plane);
    }
    return vec4(sum.xyz * parameters.inverse_spacing, sum.w);
}
