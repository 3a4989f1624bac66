// Access to the coefficients of F and the samples of h when each field fits into one binding.

@group(0) @binding(20) var<storage, read> surface_0: array<f32>;
@group(0) @binding(24) var<storage, read> sizing_0: array<f32>;

fn coefficient_at(index: u32) -> f32 {
    return surface_0[index];
}

fn size_at(index: u32) -> f32 {
    return sizing_0[index];
}
