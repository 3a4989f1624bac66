// Moves each particle in the bins of one colour once (sections 4.1, 5.1 and 5.2 of the paper). A
// workgroup processes one bin. The particles of the bin move one after another, and the lanes share
// the neighbours of the moving particle.
//
// Every third bin along each axis has the same colour, so there are 27 colours. Workgroups do not
// conflict: neighbour lists reach no farther than one bin edge, so a workgroup writes the particles
// of one bin and reads only particles of this bin and of the 26 adjacent bins. Two bins of one
// colour are separated by two other bins, so two workgroups never access the same bin. This remains
// true when particles have moved, because bins and lists do not change until the next sort.

@group(0) @binding(5) var<storage, read> bin_starts: array<u32>;

@compute @workgroup_size(TEAM)
fn move_bins(
    @builtin(workgroup_id) group: vec3<u32>,
    @builtin(num_workgroups) groups: vec3<u32>,
    @builtin(local_invocation_index) lane: u32,
) {
    let first = vec3(round.number % COLOUR_STRIDE, (round.number / COLOUR_STRIDE) % COLOUR_STRIDE, round.number / (COLOUR_STRIDE * COLOUR_STRIDE));
    // number of bins of this colour along each axis
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
        // makes the new position visible to the step of the next particle
        storageBarrier();
    }
}
