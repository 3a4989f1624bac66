// Neighbour lists: members of particle i from list_starts[i] to list_starts[i + 1].

@group(0) @binding(10) var<storage, read> list_starts: array<u32>;
@group(0) @binding(11) var<storage, read> lists: array<u32>;

// Where the list of particle i begins and ends. Lists that outgrow the buffer are cut off; the host sees it and redoes the pass.
fn list_of(i: u32) -> vec2<u32> {
    return min(vec2(list_starts[i], list_starts[i + 1u]), vec2(parameters.list_capacity));
}
