// Computes the index of the first member of each class, and the number of workgroups for the
// indirect dispatch that moves the class.

@group(0) @binding(4) var<storage, read_write> class_counts: array<u32>;
@group(0) @binding(5) var<storage, read_write> class_starts: array<u32>;
@group(0) @binding(6) var<storage, read_write> class_arguments: array<u32>;
@group(0) @binding(15) var<storage, read_write> words: array<u32>;

@compute @workgroup_size(1)
fn class_starts_kernel() {
    var start = 0u;
    var used = 0u;
    for (var c = 0u; c < CLASSES; c++) {
        let count = class_counts[c];
        class_starts[c] = start;
        // class_scatter uses this entry as the index of the next free slot
        class_counts[c] = start;
        start += count;
        used = select(used, c + 1u, count > 0u);
        let workgroups = (count + TEAMS - 1u) / TEAMS;
        // at most GROUPS_PER_ROW workgroups along x, the rest along y
        class_arguments[3u * c] = min(workgroups, GROUPS_PER_ROW);
        class_arguments[3u * c + 1u] = (workgroups + GROUPS_PER_ROW - 1u) / GROUPS_PER_ROW;
        class_arguments[3u * c + 2u] = 1u;
    }
    class_starts[CLASSES] = start;
    words[WORD_CLASSES] = used;
}
