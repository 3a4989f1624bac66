// Test kernel: evaluates F (or the half difference G of the particle's interface), h and their
// gradients at each particle, and reports whether the projection of the particle succeeds. One team
// processes each particle.

@group(0) @binding(8) var<storage, read> place: array<vec4<f32>>;
@group(0) @binding(9) var<storage, read> normal: array<vec4<f32>>;
@group(0) @binding(12) var<storage, read_write> probed: array<vec4<f32>>;

@compute @workgroup_size(TEAM * TEAMS)
fn probe_fields(
    @builtin(workgroup_id) group: vec3<u32>,
    @builtin(num_workgroups) groups: vec3<u32>,
    @builtin(local_invocation_index) local: u32,
) {
    let lane = local % TEAM;
    let i = flat_group(group, groups) * TEAMS + local / TEAM;
    if i >= now.count {
        return;
    }
    choose_surface(normal[i].w);
    let surface = surface_at(place[i].xyz, lane);
    let there = project(place[i].xyz, parameters.spacing.x, lane);
    if lane == 0u {
        probed[3u * i] = surface;
        probed[3u * i + 1u] = sizing_at(place[i].xyz);
        probed[3u * i + 2u] = vec4(select(0.0, 1.0, there.found));
    }
}
