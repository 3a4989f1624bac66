// Test kernel: for each particle, computes the energy with its gradient and Hessian, and F with its
// gradient. One team processes each particle.

@group(0) @binding(8) var<storage, read> place: array<vec4<f32>>;
@group(0) @binding(9) var<storage, read> normal: array<vec4<f32>>;
@group(0) @binding(12) var<storage, read_write> probed: array<vec4<f32>>;

@compute @workgroup_size(TEAM * TEAMS)
fn probe_jets(
    @builtin(workgroup_id) group: vec3<u32>,
    @builtin(num_workgroups) groups: vec3<u32>,
    @builtin(local_invocation_index) local: u32,
) {
    let lane = local % TEAM;
    let i = flat_group(group, groups) * TEAMS + local / TEAM;
    if i >= now.count {
        return;
    }
    let own = place[i];
    let list = list_of(i);
    let plane = tangent_plane(normal[i].xyz);
    choose_surface(normal[i].w);
    let nearest = nearest_neighbours(list, lane);
    let jet = team_jet(own, plane, list, nearest, lane);
    let energy = team_energy(own, list, nearest, lane);
    let surface = surface_at(own.xyz, lane);
    if lane == 0u {
        probed[3u * i] = vec4(plane.u * jet.gradient.x + plane.v * jet.gradient.y, jet.energy);
        probed[3u * i + 1u] = vec4(jet.hessian, energy);
        probed[3u * i + 2u] = surface;
    }
}
