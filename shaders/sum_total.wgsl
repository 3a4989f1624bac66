// Totals of a pass, second step: one workgroup adds up the blocks and writes the words that the host reads.

@group(0) @binding(6) var<storage, read> block_totals: array<Totals>;
@group(0) @binding(10) var<storage, read> list_starts: array<u32>;
// Energy (bits of an f32), moved, tries, longest way since the lists were made over h (bits of an f32), members of all lists,
// particles after density control, kept of the old ones, faults.
@group(0) @binding(15) var<storage, read_write> words: array<u32>;

@compute @workgroup_size(256)
fn sum_total(@builtin(local_invocation_index) lane: u32) {
    let blocks = (now.count + 2047u) / 2048u;
    var own = Totals();
    for (var block = lane; block < blocks; block += 256u) {
        own = add_totals(own, block_totals[block]);
    }
    let total = total_of_group(own, lane);
    if lane == 0u {
        words[0] = bitcast<u32>(total.energy);
        words[1] = total.moved;
        words[2] = total.tries;
        words[3] = bitcast<u32>(total.longest);
        words[4] = list_starts[now.count];
        words[5] = now.count;
        words[6] = now.count;
        words[7] = total.faults;
    }
}
