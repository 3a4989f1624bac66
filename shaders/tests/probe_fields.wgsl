// For the tests: F with its gradient, and h with its gradient, at the particles' places, by one invocation each.

@group(0) @binding(8) var<storage, read> place: array<vec4<f32>>;
@group(0) @binding(9) var<storage, read_write> probed: array<vec4<f32>>;

@compute @workgroup_size(NARROW)
fn probe_fields(
    @builtin(workgroup_id) group: vec3<u32>,
    @builtin(num_workgroups) groups: vec3<u32>,
    @builtin(local_invocation_index) lane: u32,
) {
    let i = flat_group(group, groups) * NARROW + lane;
    if i < now.count {
        probed[2u * i] = surface_at(place[i].xyz, lane);
        probed[2u * i + 1u] = sizing_at(place[i].xyz);
    }
}
