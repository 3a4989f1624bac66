// What the kernels of a pass know of it. A pass may be handed over while the one before it is at work: then the number of its particles is known here alone, and where
// that is more than the pass was made for, or the one before has to be done again, it is of no particle and changes nothing that the host goes back to.

struct Planned {
    number: u32,
    // Particles, or AS_LEFT: as many as the pass before has left.
    count: u32,
    allow_insert: u32,
    // Particles that the pass was made for.
    room: u32,
    // The longest list that there was room for in the pass before, and the classes that it was made for.
    list_room: u32,
    classes: u32,
    unused_1: u32,
    unused_2: u32,
}

@group(0) @binding(2) var<uniform> planned: Planned;
// The buffers `now` and `scan_keep`, which the other kernels read.
@group(0) @binding(3) var<storage, read_write> begun: array<u32>;
@group(0) @binding(4) var<storage, read_write> begun_scan: array<u32>;
@group(0) @binding(15) var<storage, read> words: array<u32>;

@compute @workgroup_size(1)
fn begin_pass() {
    var count = planned.count;
    if count == AS_LEFT {
        count = words[WORD_COUNT];
        let is_to_be_redone = words[WORD_LONGEST_LIST] > planned.list_room || words[WORD_CLASSES] > planned.classes;
        if is_to_be_redone || count > planned.room {
            count = 0u;
        }
    }
    begun[0] = planned.number;
    begun[1] = count;
    begun[2] = planned.allow_insert;
    // flags of all particles and of their newcomers
    begun_scan[0] = 2u * count;
    begun_scan[1] = (2u * count + BLOCK) / BLOCK;
}
