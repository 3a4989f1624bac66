// The energy of every particle (Eq. 1), and a clean slate for density control.

@group(0) @binding(8) var<storage, read> place: array<vec4<f32>>;
@group(0) @binding(12) var<storage, read_write> energies: array<f32>;
// 0: stays; n: deleted in round n.
@group(0) @binding(13) var<storage, read_write> marks: array<u32>;
// The last round in which a neighbour was deleted.
@group(0) @binding(14) var<storage, read_write> touched: array<u32>;

@compute @workgroup_size(64)
fn energies_kernel(
    @builtin(workgroup_id) group: vec3<u32>,
    @builtin(num_workgroups) groups: vec3<u32>,
    @builtin(local_invocation_index) lane: u32,
) {
    let i = flat_group(group, groups) * 64u + lane;
    if i >= now.count {
        return;
    }
    let own = place[i];
    let range = list_of(i);
    var sum = 0.0;
    for (var k = range.x; k < range.y; k++) {
        let other = place[lists[k]];
        sum += energy_between(own.xyz - other.xyz, own.w, other.w);
    }
    energies[i] = sum;
    marks[i] = 0u;
    touched[i] = 0u;
}
