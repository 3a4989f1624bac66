// Access to the coefficients of F and the samples of h when a field exceeds the maximum binding
// size of the adapter. Each field is split by linear index into up to four slabs of
// parameters.slab_length values.

@group(0) @binding(20) var<storage, read> surface_0: array<f32>;
@group(0) @binding(21) var<storage, read> surface_1: array<f32>;
@group(0) @binding(22) var<storage, read> surface_2: array<f32>;
@group(0) @binding(23) var<storage, read> surface_3: array<f32>;
@group(0) @binding(24) var<storage, read> sizing_0: array<f32>;
@group(0) @binding(25) var<storage, read> sizing_1: array<f32>;
@group(0) @binding(26) var<storage, read> sizing_2: array<f32>;
@group(0) @binding(27) var<storage, read> sizing_3: array<f32>;

fn coefficient_at(index: u32) -> f32 {
    let within = index % parameters.slab_length;
    switch index / parameters.slab_length {
        case 0u: { return surface_0[within]; }
        case 1u: { return surface_1[within]; }
        case 2u: { return surface_2[within]; }
        default: { return surface_3[within]; }
    }
}

fn size_at(index: u32) -> f32 {
    let within = index % parameters.slab_length;
    switch index / parameters.slab_length {
        case 0u: { return sizing_0[within]; }
        case 1u: { return sizing_1[within]; }
        case 2u: { return sizing_2[within]; }
        default: { return sizing_3[within]; }
    }
}
