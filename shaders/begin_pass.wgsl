// Writes the parameters that the other kernels of a pass read. The host may submit a pass before it
// has read the result of the previous pass. The number of particles is then read on the device. The
// kernel sets it to 0 if the previous pass must be repeated or left more particles than this pass
// can process. This pass then leaves its input unchanged.

struct Planned {
    number: u32,
    // Number of particles, or COUNT_ON_DEVICE if the kernel must read it from `words`.
    count: u32,
    allow_insert: u32,
    // Maximum number of particles that this pass can process.
    room: u32,
    // Capacity of each neighbour list, and number of classes that the previous pass dispatched.
    list_room: u32,
    classes: u32,
    unused_1: u32,
    unused_2: u32,
}

@group(0) @binding(2) var<uniform> planned: Planned;
// `begun` and `begun_scan` are the buffers `now` and `scan_keep`, which the other kernels read.
@group(0) @binding(3) var<storage, read_write> begun: array<u32>;
@group(0) @binding(4) var<storage, read_write> begun_scan: array<u32>;
@group(0) @binding(15) var<storage, read> words: array<u32>;

@compute @workgroup_size(1)
fn begin_pass() {
    var count = planned.count;
    if count == COUNT_ON_DEVICE {
        count = words[WORD_COUNT];
        let is_to_be_redone = words[WORD_LONGEST_LIST] > planned.list_room || words[WORD_CLASSES] > planned.classes;
        if is_to_be_redone || count > planned.room {
            count = 0u;
        }
    }
    begun[0] = planned.number;
    begun[1] = count;
    begun[2] = planned.allow_insert;
    // one flag for each particle and one for its newcomer
    begun_scan[0] = 2u * count;
    begun_scan[1] = (2u * count + SUM_BLOCK) / SUM_BLOCK;
}
