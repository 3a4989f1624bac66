// Coefficients of G = (F_i - F_j) / 2 at the grid nodes, for the interface of materials i > j. The
// differences are stored in blocks of 4 x 4 x 4 coefficients. The index contains, for each brick of
// 4 x 4 x 4 cells, records that locate the blocks (stages/particles/src/gpu/differences.rs
// documents the layout). Finding a record takes two dependent reads, so a record stays loaded until
// a cell in another brick is needed. A projection rarely leaves the brick in which it starts.
//
// Twin: `gather` in common/field/src/materials/indicator.rs
// Twin: `is_real_interface` in common/field/src/materials/index.rs

// Index of the interface to evaluate.
var<private> chosen: u32;
// The brick whose record is loaded, and its first cell.
var<private> open_brick: u32;
var<private> open_start: vec3<u32>;
// The interface of the loaded record, and the index of the next entry of the brick (0 if there is
// none).
var<private> open_interface: u32;
var<private> open_next: u32;
// The index of the loaded record, and the first three of its four vectors.
var<private> open_at: u32;
var<private> open_low: vec4<u32>;
var<private> open_high: vec4<u32>;
var<private> open_cells: vec4<u32>;
// True if the indicators of both materials are stored for the current cell.
var<private> is_known: bool;

// Selects the interface of a particle for subsequent calls.
fn choose_surface(carried: f32) {
    chosen = u32(carried) >> 4u;
    open_brick = NO_BRICK;
}

fn open_record(at: u32) {
    open_at = at;
    open_low = materials_index[at];
    open_high = materials_index[at + 1u];
    open_cells = materials_index[at + 2u];
}

// Looks up the chosen interface in an entry, which refers to at most two interfaces. If the entry
// does not refer to it, takes the first interface of the entry. Returns the index of the record.
fn take_entry(entry: vec4<u32>) -> u32 {
    let is_second = entry.z == chosen;
    open_interface = select(entry.x, entry.z, is_second);
    open_next = select(0u, entry.w, entry.z == MORE_INTERFACES);
    return select(entry.y, entry.w, is_second);
}

// Loads the record of the chosen interface if the first entry of the brick refers to it. Otherwise
// loads the record of the first interface in that entry.
fn ask_for_cell(cell: Cell) {
    let bricks = max((parameters.grid_size + 2u) / 4u, vec3(1u));
    let at = vec3<u32>(cell.base) / 4u;
    open_brick = (at.z * bricks.y + at.y) * bricks.x + at.x;
    open_start = 4u * at;
    open_record(take_entry(materials_index[INDEX_BRICKS + open_brick]));
}

// Loads the record of the chosen interface for the brick that contains the cell. If the brick has
// no such record, the coefficients are zero.
fn open_cell(cell: Cell) {
    if any(vec3<u32>(cell.base) / 4u != open_start / 4u) || open_brick == NO_BRICK {
        ask_for_cell(cell);
    }
    if open_interface != chosen {
        var at = 0u;
        while open_interface != chosen && open_next != 0u {
            at = take_entry(materials_index[open_next]);
        }
        if open_interface == chosen {
            open_record(at);
        } else {
            open_cells = vec4(0u);
            open_interface = chosen;
        }
    }
    is_known = is_of(open_cells.xy, vec3<u32>(cell.base));
}

// Returns whether the bit mask `cells` contains a cell of the open brick.
fn is_of(cells: vec2<u32>, base: vec3<u32>) -> bool {
    let within = base - open_start;
    let bit = 16u * (within.z & 1u) + 4u * within.y + within.x;
    return ((select(cells.x, cells.y, within.z >= 2u) >> bit) & 1u) != 0u;
}

// Returns the coefficient at a node. If either indicator is not stored for the current cell, all
// coefficients are zero. The gradient is then zero too, which ends the projection.
fn node_coefficient(at: vec3<i32>) -> f32 {
    if !is_known {
        return 0.0;
    }
    let node = vec3<u32>(at + 1) - open_start;
    let of_four = select(open_low, open_high, node.z >= 4u);
    let of_two = select(of_four.xy, of_four.zw, node.y >= 4u);
    let block = select(of_two.x, of_two.y, node.x >= 4u);
    return coefficient_at(64u * block + 16u * (node.z & 3u) + 4u * (node.y & 3u) + (node.x & 3u));
}

// Remaining checks for third materials at a point on the interface: the index of the next check,
// and the end of the range of checks.
var<private> next_check: u32;
var<private> end_of_checks: u32;
// True if the difference for the current check is stored with the opposite sign.
var<private> is_negative: bool;

// Prepares the checks for third materials in a cell. Returns CHECKS_FAIL if a third material fills
// the brick, otherwise CHECKS_PASS.
fn begin_checks(cell: Cell) -> u32 {
    next_check = 0u;
    end_of_checks = 0u;
    if !is_of(open_cells.zw, vec3<u32>(cell.base)) {
        return CHECKS_PASS;
    }
    let checks = materials_index[open_at + 3u];
    if checks.y == NEVER_REAL {
        return CHECKS_FAIL;
    }
    next_check = checks.x;
    end_of_checks = checks.x + checks.y;
    return CHECKS_PASS;
}

// Loads the record for the next third material that may be equally close in the cell, and returns
// CHECKS_GO_ON. Returns CHECKS_PASS if there is none, and CHECKS_FAIL if the material fills the
// cell.
fn open_check(cell: Cell) -> u32 {
    let base = vec3<u32>(cell.base);
    while next_check < end_of_checks {
        let check = materials_index[next_check];
        next_check++;
        if is_of(check.zw, base) {
            open_record(check.x);
            if !is_of(open_cells.xy, base) {
                // a third material whose difference is not stored for the cell fills the cell
                return CHECKS_FAIL;
            }
            is_negative = check.y != 0u;
            return CHECKS_GO_ON;
        }
    }
    return CHECKS_PASS;
}

fn passes_check(difference: f32) -> bool {
    return select(difference, -difference, is_negative) > 0.0;
}

// Ends the checks. Marks the record of the interface as no longer loaded.
fn end_checks() {
    open_brick = NO_BRICK;
}
