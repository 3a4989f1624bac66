// Finds the voxel-grid cell that contains a position and interpolates h trilinearly. Device
// positions are in mm, relative to the centre of voxel parameters.centre. Because the origin is a
// voxel centre, conversion to a grid index adds an integer and does not round the fractional
// position within a cell.
//
// Twin: `SizingField`, `value_gradient` in common/field/src/sizing.rs

struct Cell {
    base: vec3<i32>,
    fraction: vec3<f32>,
}

// Returns the cell that contains a position and the fractional position within it, both clamped to
// the grid.
fn cell_at(position: vec3<f32>) -> Cell {
    let index = position * parameters.inverse_spacing;
    let whole = floor(index);
    let last = vec3<i32>(parameters.grid_size) - 1;
    var base = vec3<i32>(whole) + parameters.centre;
    var fraction = index - whole;
    let outside = (base < vec3(0)) | (base >= last);
    base = clamp(base, vec3(0), last);
    fraction = select(fraction, vec3(0.0), outside);
    // a position beyond the last sample maps to the far end of the last cell
    let top = max(last - 1, vec3(0));
    fraction = select(fraction, vec3(1.0), base > top);
    return Cell(min(base, top), fraction);
}

// Returns whether a position lies between the first and the last sample on each axis, with a
// tolerance of a thousandth of the voxel spacing. The CPU counterpart is `Geometry::holds`.
fn is_in_grid(position: vec3<f32>) -> bool {
    let index = position * parameters.inverse_spacing + vec3<f32>(parameters.centre);
    let last = vec3<f32>(parameters.grid_size) - 1.0;
    return all(index >= vec3(-1e-3)) && all(index <= last + 1e-3);
}

fn linear_index(at: vec3<i32>) -> u32 {
    let n = parameters.grid_size;
    return (u32(at.z) * n.y + u32(at.y)) * n.x + u32(at.x);
}

// Returns the gradient of h (xyz, dimensionless) and h in mm (w).
fn sizing_at(position: vec3<f32>) -> vec4<f32> {
    let cell = cell_at(position);
    let next = min(cell.base + 1, vec3<i32>(parameters.grid_size) - 1);
    let b = cell.base;
    let t = cell.fraction;
    let v000 = size_at(linear_index(b));
    let v100 = size_at(linear_index(vec3(next.x, b.y, b.z)));
    let v010 = size_at(linear_index(vec3(b.x, next.y, b.z)));
    let v110 = size_at(linear_index(vec3(next.x, next.y, b.z)));
    let v001 = size_at(linear_index(vec3(b.x, b.y, next.z)));
    let v101 = size_at(linear_index(vec3(next.x, b.y, next.z)));
    let v011 = size_at(linear_index(vec3(b.x, next.y, next.z)));
    let v111 = size_at(linear_index(next));
    // interpolate along x first, on the four edges of the cell
    let e00 = v000 + (v100 - v000) * t.x;
    let e10 = v010 + (v110 - v010) * t.x;
    let e01 = v001 + (v101 - v001) * t.x;
    let e11 = v011 + (v111 - v011) * t.x;
    let low = e00 + (e10 - e00) * t.y;
    let high = e01 + (e11 - e01) * t.y;
    let gradient = vec3(
        mix(mix(v100 - v000, v110 - v010, t.y), mix(v101 - v001, v111 - v011, t.y), t.z),
        mix(e10 - e00, e11 - e01, t.z),
        high - low,
    );
    return vec4(gradient * parameters.inverse_spacing, min(low + (high - low) * t.z, parameters.largest_size));
}
