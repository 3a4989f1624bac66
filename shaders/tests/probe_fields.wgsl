// For the tests: F, or G of its sheet, with its gradient, and h with its gradient, at the particles' places, by one invocation each; and whether its sheet is real there.

@group(0) @binding(8) var<storage, read> place: array<vec4<f32>>;
@group(0) @binding(9) var<storage, read> normal: array<vec4<f32>>;
@group(0) @binding(12) var<storage, read_write> probed: array<vec4<f32>>;

@compute @workgroup_size(NARROW)
fn probe_fields(
    @builtin(workgroup_id) group: vec3<u32>,
    @builtin(num_workgroups) groups: vec3<u32>,
    @builtin(local_invocation_index) lane: u32,
) {
    let i = flat_group(group, groups) * NARROW + lane;
    if i < now.count {
        choose_surface(normal[i].w);
        probed[3u * i] = surface_at(place[i].xyz, lane);
        probed[3u * i + 1u] = sizing_at(place[i].xyz);
        probed[3u * i + 2u] = vec4(select(0.0, 1.0, is_real(place[i].xyz, lane)));
    }
}
