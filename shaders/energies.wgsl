// The energy of every particle (Eq. 1), whether the lattice has a fault there, and a clean slate for density control.

@group(0) @binding(8) var<storage, read> place: array<vec4<f32>>;
@group(0) @binding(12) var<storage, read_write> energies: array<f32>;
// 0: stays; n: deleted in round n.
@group(0) @binding(13) var<storage, read_write> marks: array<u32>;
// The last round in which a neighbour was deleted.
@group(0) @binding(14) var<storage, read_write> touched: array<u32>;

// Steps tried; the top bit says that one was taken, the next that the particle has not six neighbours in the first ring.
@group(0) @binding(15) var<storage, read_write> outcome: array<u32>;

// Between the first ring of the lattice and the second, in h.
const FIRST_RING: f32 = 1.3160740;

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
    var ring = 0u;
    for (var k = range.x; k < range.y; k++) {
        let other = place[lists[k]];
        let offset = own.xyz - other.xyz;
        sum += energy_between(offset, own.w, other.w);
        let reach = FIRST_RING * min(own.w, other.w);
        ring += select(0u, 1u, dot(offset, offset) < reach * reach);
    }
    energies[i] = sum;
    outcome[i] = (outcome[i] & 0xbfffffffu) | select(0u, 0x40000000u, ring != 6u);
    marks[i] = 0u;
    touched[i] = 0u;
}
