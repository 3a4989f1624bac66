// One pass of movement for the bins of one colour, as sections 4.1, 5.1 and 5.2 of the paper have it: a workgroup works for a bin, whose particles move one after the
// other, and its lanes share out the neighbours of the one that moves.
//
// Every third bin along each axis has one colour, so there are 27. No conflict: a list reaches no farther than a bin is wide, so what a workgroup reads lies in its bin and
// the 26 round it, and what it writes in its bin; between two bins of a colour there are two others, so no such neighbourhoods meet. That holds until the
// next sort wherever the particles go meanwhile: bins and lists are those of the last sort.

@group(0) @binding(5) var<storage, read> bin_starts: array<u32>;

@compute @workgroup_size(TEAM)
fn move_bins(
    @builtin(workgroup_id) group: vec3<u32>,
    @builtin(num_workgroups) groups: vec3<u32>,
    @builtin(local_invocation_index) lane: u32,
) {
    let first = vec3(round.number % COLOUR_STRIDE, (round.number / COLOUR_STRIDE) % COLOUR_STRIDE, round.number / (COLOUR_STRIDE * COLOUR_STRIDE));
    // bins of this colour along each axis
    let bins = (parameters.levels[0].bins + (COLOUR_STRIDE - 1u) - first) / COLOUR_STRIDE;
    let number = flat_group(group, groups);
    if number >= bins.x * bins.y * bins.z {
        return;
    }
    let nth = vec3(number % bins.x, (number / bins.x) % bins.y, number / (bins.x * bins.y));
    let bin = bin_number(vec3<i32>(first + COLOUR_STRIDE * nth), 0u);
    let end = bin_starts[bin + 1u];
    for (var i = bin_starts[bin]; i < end; i++) {
        move_particle(i, lane);
        // the next one sees where this one has gone to
        storageBarrier();
    }
}
