// The coefficients of G = (F_i - F_j) / 2 at nodes of the grid, for the sheet between materials i and j: each F is held in blocks of 4 x 4 x 4
// coefficients, and each brick of 4 x 4 x 4 cells tells which materials are known in it and which eight blocks it reads of each.
//
// Twin: `gather` in common/field/src/materials/indicator.rs
// Twin: `is_real_sheet` in common/field/src/materials/index.rs

// The two materials, that on the negative side first.
var<private> chosen: vec2<u32>;
// The brick that is open, its first node, and its number among the bricks of each of the two.
var<private> open_brick: u32;
var<private> open_start: vec3<i32>;
var<private> open_numbers: vec2<u32>;

fn choose_surface(carried: f32) {
    chosen = materials_of(carried).yx;
}

// Whether all that a cell reads of a material lies in the material's box.
fn is_within(material: u32, base: vec3<i32>) -> bool {
    let at = materials_index[INDEX_BOXES] + 8u * material;
    let first = vec3<i32>(vec3(materials_index[at], materials_index[at + 1u], materials_index[at + 2u]));
    let end = vec3<i32>(vec3(materials_index[at + 3u], materials_index[at + 4u], materials_index[at + 5u]));
    let low = (base > first) | (first == vec3(0));
    let high = (base + 2 < end) | (end == vec3<i32>(parameters.grid_size));
    return all(low & high);
}

fn open_cell(cell: Cell) {
    let bricks = max((vec3<i32>(parameters.grid_size) + 2) / 4, vec3(1));
    let at = cell.base / 4;
    open_brick = u32((at.z * bricks.y + at.y) * bricks.x + at.x);
    open_start = 4 * at;
    open_numbers = vec2(NO_BRICK);
    let end = materials_index[materials_index[INDEX_STARTS] + open_brick + 1u];
    for (var k = materials_index[materials_index[INDEX_STARTS] + open_brick]; k < end; k++) {
        let entry = materials_index[INDEX_ENTRIES] + 2u * k;
        let is_chosen = vec2(materials_index[entry]) == chosen;
        if any(is_chosen) && is_within(materials_index[entry], cell.base) {
            open_numbers = select(open_numbers, vec2(materials_index[entry + 1u]), is_chosen);
        }
    }
}

fn block_coefficient(number: u32, block: i32, inner: i32) -> f32 {
    let at = materials_index[INDEX_BLOCKS] + 8u * number + u32(block);
    return coefficient_at(64u * materials_index[at] + u32(inner));
}

// Zero where one of the two is not known: the slope tells that there is no sheet.
fn node_coefficient(at: vec3<i32>) -> f32 {
    if any(open_numbers == vec2(NO_BRICK)) {
        return 0.0;
    }
    let place = at + 1 - open_start;
    let block = 4 * (place.z / 4) + 2 * (place.y / 4) + place.x / 4;
    let inner = 16 * (place.z % 4) + 4 * (place.y % 4) + place.x % 4;
    return 0.5 * (block_coefficient(open_numbers.x, block, inner) - block_coefficient(open_numbers.y, block, inner));
}

// Whether no third material is as near as the two at a place on their sheet.
fn is_real(position: vec3<f32>, lane: u32) -> bool {
    let own = chosen;
    let base = cell_at(position).base;
    open_cell(cell_at(position));
    let brick = open_brick;
    let fill = materials_index[materials_index[INDEX_FILL] + brick];
    var real = fill == 0xffffu || any(vec2(fill) == own);
    let end = materials_index[materials_index[INDEX_STARTS] + brick + 1u];
    for (var k = materials_index[materials_index[INDEX_STARTS] + brick]; k < end; k++) {
        let third = materials_index[materials_index[INDEX_ENTRIES] + 2u * k];
        if all(vec2(third) != own) {
            if is_within(third, base) {
                chosen = vec2(third, own.x);
                real = real && surface_at(position, lane).w > 0.0;
            } else {
                real = real && materials_index[materials_index[INDEX_BOXES] + 8u * third + 6u] == 0u;
            }
        }
    }
    chosen = own;
    return real;
}
