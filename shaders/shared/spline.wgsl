// The cubic B-spline F and its gradient, evaluated in f32 without hardware filtering. The
// coefficients are mirrored at the border of the grid.
//
// Twin: `Stencil`, `mirror` in common/field/src/spline/stencil.rs

// Returns the weight of tap 0, 1, 2 or 3 at fraction t of a cell, and the derivative of the weight.
fn tap_weight(tap: u32, t: f32) -> vec2<f32> {
    let left = tap < 2u;
    let s = select(1.0 - t, t, left);
    let sign = select(-1.0, 1.0, left);
    let r = 1.0 - s;
    if tap == 0u || tap == 3u {
        return vec2(r * r * r / 6.0, -0.5 * sign * r * r);
    }
    return vec2((4.0 + s * s * (3.0 * s - 6.0)) / 6.0, sign * s * (1.5 * s - 2.0));
}

// Mirrors index i at both ends of a row of n samples.
fn mirrored(i: i32, n: i32) -> i32 {
    let low = abs(i);
    return select(select(low, 2 * (n - 1) - low, low > n - 1), 0, n == 1);
}

// Returns the contribution of taps (x, y, z) and (x, y, z + 1) to the gradient per voxel (xyz) and
// to the value (w); `plane` is x + 4 y. The sum over taps is unrolled by hand, because naga adds a
// counter to every loop; drivers then neither unroll the loop nor issue its loads together.
fn two_taps(cell: Cell, plane: u32, z: u32) -> vec4<f32> {
    let step = vec3(plane & 3u, plane >> 2u, z);
    let size = vec3<i32>(parameters.grid_size);
    let at = cell.base + vec3<i32>(step) - 1;
    let x = mirrored(at.x, size.x);
    let y = mirrored(at.y, size.y);
    let near = node_coefficient(vec3(x, y, mirrored(at.z, size.z)));
    let far = node_coefficient(vec3(x, y, mirrored(at.z + 1, size.z)));
    let u = tap_weight(step.x, cell.fraction.x);
    let v = tap_weight(step.y, cell.fraction.y);
    let w = near * tap_weight(z, cell.fraction.z) + far * tap_weight(z + 1u, cell.fraction.z);
    return vec4(u.y * v.x * w.x, u.x * v.y * w.x, u.x * v.x * w.y, u.x * v.x * w.x);
}

// Returns the contribution of the four taps (x, y, 0) to (x, y, 3), in the same form as two_taps.
fn four_taps(cell: Cell, plane: u32) -> vec4<f32> {
    return two_taps(cell, plane, 0u) + two_taps(cell, plane, 2u);
}
