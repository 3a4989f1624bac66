// The coefficients of F at nodes of the grid.

fn choose_surface(carried: f32) {}

fn open_cell(cell: Cell) {}

fn node_coefficient(at: vec3<i32>) -> f32 {
    return coefficient_at(linear_index(at));
}

fn is_real(position: vec3<f32>, lane: u32) -> bool {
    return true;
}
