// The coefficients of G = (F_i - F_j) / 2 at nodes of the grid, for the sheet between materials i and j. They are held as such, in blocks of 4 x 4 x 4 that the index of
// materials finds by the brick of 4 x 4 x 4 cells (stages/particles/src/gpu/differences.rs says how). A look into it costs two reads that wait for each other, so
// what it says is kept until another brick is asked for: the steps of a projection hardly ever leave one.
//
// Twin: `gather` in common/field/src/materials/indicator.rs
// Twin: `is_real_sheet` in common/field/src/materials/index.rs

// The sheet.
var<private> chosen: u32;
// The brick that is open, its first node, the blocks that it reads, and the last four words of its record.
var<private> open_brick: u32;
var<private> open_start: vec3<i32>;
var<private> open_low: vec4<u32>;
var<private> open_high: vec4<u32>;
var<private> open_cells: vec4<u32>;
// Whether both materials are known in the cell.
var<private> is_known: bool;

fn choose_surface(carried: f32) {
    chosen = u32(carried) >> 4u;
    open_brick = NO_BRICK;
}

fn open_record(at: u32) {
    open_low = materials_index[at];
    open_high = materials_index[at + 1u];
    open_cells = materials_index[at + 2u];
}

fn open_cell(cell: Cell) {
    let bricks = max((vec3<i32>(parameters.grid_size) + 2) / 4, vec3(1));
    let at = cell.base / 4;
    let brick = u32((at.z * bricks.y + at.y) * bricks.x + at.x);
    if brick != open_brick {
        open_brick = brick;
        open_start = 4 * at;
        var entry = materials_index[INDEX_BRICKS + brick];
        while entry.x != chosen && entry.z != 0u {
            entry = materials_index[entry.z];
        }
        if entry.x == chosen {
            open_record(entry.y);
        } else {
            open_cells = vec4(0u);
        }
    }
    look_at_cell(cell.base);
}

fn look_at_cell(base: vec3<i32>) {
    let within = base - open_start;
    let bit = u32(16 * (within.z & 1) + 4 * within.y + within.x);
    is_known = ((select(open_cells.x, open_cells.y, within.z >= 2) >> bit) & 1u) != 0u;
}

// Zero where one of the two is not known: the slope tells that there is no sheet.
fn node_coefficient(at: vec3<i32>) -> f32 {
    if !is_known {
        return 0.0;
    }
    let place = vec3<u32>(at + 1 - open_start);
    let of_four = select(open_low, open_high, place.z >= 4u);
    let of_two = select(of_four.xy, of_four.zw, place.y >= 4u);
    let block = select(of_two.x, of_two.y, place.x >= 4u);
    return coefficient_at(64u * block + 16u * (place.z & 3u) + 4u * (place.y & 3u) + (place.x & 3u));
}

// Whether no third material is as near as the two at a place on their sheet, whose cell is open.
fn is_real(position: vec3<f32>, lane: u32) -> bool {
    let count = open_cells.w;
    if count == 0u {
        return true;
    }
    if count == NEVER_REAL {
        return false;
    }
    let low = open_low;
    let high = open_high;
    let cells = open_cells;
    let base = cell_at(position).base;
    var real = true;
    for (var k = 0u; k < count; k++) {
        let check = materials_index[cells.z + k];
        // the difference from a third material, read as that of the sheet is
        open_record(check.x);
        look_at_cell(base);
        if is_known {
            let difference = surface_at(position, lane).w;
            real = real && select(difference, -difference, check.y != 0u) > 0.0;
        } else {
            real = real && check.z == 0u;
        }
    }
    open_low = low;
    open_high = high;
    open_cells = cells;
    return real;
}
