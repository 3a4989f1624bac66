//! The kernels of a pass, their order and their workgroup counts.

use super::constants::{CLASSES, COLOUR_STRIDE, PARTICLE_GROUP, SUM_BLOCK, SUM_GROUP};
use super::levels::BinLevels;
use super::parameters::scan_blocks;
use crate::settle::Order;
use glam::UVec3;

/// Number of rounds that assign classes. A particle without a class does not move until the lists
/// are rebuilt. Measured with 3, 4, 6, 8 and 12 rounds on the heart of docs/developer/method.md
/// (`--backend gpu --adapter llvmpipe --max-passes 60`): the results with 6, 8 and 12 are
/// identical, so rounds after the sixth change nothing. `tests/lists.rs` requires that 99.5 % of
/// the particles have a class, or 80 % where the particles are too dense.
const CLASS_ROUNDS: u32 = 6;
/// Number of deletion rounds per pass. A comment in `shaders/density_delete.wgsl` compares the
/// rounds with the deletion order on the CPU. Measured on the same heart as [`CLASS_ROUNDS`]: with
/// the default seeds, 3 and 5 rounds give identical results. With seeds from marching cubes (`seed
/// --from marching-cubes`), which are too dense, 1, 2, 3 and 4 rounds leave 6235, 4815, 4761 and
/// 4747 particles after 60 passes.
const DELETION_ROUNDS: u32 = 3;

/// Number of bin colours.
pub(crate) const COLOURS: u32 = COLOUR_STRIDE * COLOUR_STRIDE * COLOUR_STRIDE;

const _: () = assert!(COLOURS <= CLASSES, "the buffer `round` has a number for each class");

/// Returns the number of bins of a colour; `bins` is the number of bins along each axis.
pub(crate) fn bins_of(colour: u32, bins: UVec3) -> u32 {
    let first = UVec3::new(colour, colour / COLOUR_STRIDE, colour / (COLOUR_STRIDE * COLOUR_STRIDE)) % COLOUR_STRIDE;
    ((bins + (COLOUR_STRIDE - 1) - first) / COLOUR_STRIDE).element_product()
}

/// Buffers bound under other names in a kernel: (name in the kernel, name of the buffer).
pub(crate) type Aliases = &'static [(&'static str, &'static str)];

/// The two sets of listed buffers: a pass with density control reads one set and writes the other.
pub(crate) const LISTED_SETS: [Aliases; 2] = [
    &[("listed_place", "listed_place_0"), ("listed_normal", "listed_normal_0")],
    &[("listed_place", "listed_place_1"), ("listed_normal", "listed_normal_1")],
];

/// Returns the names of the buffers of a set: positions and normals.
pub(crate) fn listed(set: usize) -> [&'static str; 2] {
    [LISTED_SETS[set][0].1, LISTED_SETS[set][1].1]
}

/// One dispatch of a pass.
pub(crate) struct Step {
    pub kernel: &'static str,
    /// Name that distinguishes dispatches of one kernel over different buffers.
    pub label: &'static str,
    /// Value of the variable `round` of the kernel.
    pub round: u32,
    pub aliases: Aliases,
    /// Number of workgroups. `None` for an indirect dispatch, where the device computes it from the
    /// size of the class.
    pub workgroups: Option<u32>,
}

impl Step {
    pub(crate) fn over(kernel: &'static str, round: u32, workgroups: u32) -> Self {
        Self { kernel, label: kernel, round, aliases: &[], workgroups: Some(workgroups) }
    }

    fn with(self, aliases: Aliases) -> Self {
        Self { aliases, ..self }
    }
}

/// The optional parts of a pass, the listed buffers that it reads, and its number of classes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Plan {
    /// True if the pass sorts the particles and rebuilds lists and classes.
    pub sort: bool,
    /// True if the pass first copies the particles from the sorted to the listed buffers.
    pub bring: bool,
    /// True if the pass controls the density.
    pub density: bool,
    /// Set of listed buffers that the pass reads.
    pub set: usize,
    /// Number of classes that are dispatched.
    pub classes: u32,
}

/// Returns the first step of every pass.
pub(crate) fn beginning() -> Step {
    Step::over("begin_pass", 0, 1).with(&[("begun", "now"), ("begun_scan", "scan_keep")])
}

/// Returns the dispatches of a pass, in order.
pub(crate) fn steps(count: u32, levels: &BinLevels, order: Order, plan: Plan) -> Vec<Step> {
    let Plan { sort, density, set, classes, .. } = plan;
    let mut steps = Vec::with_capacity(80);
    steps.push(beginning());
    let each = count.div_ceil(PARTICLE_GROUP);
    let wide = count.div_ceil(SUM_GROUP);
    if sort {
        steps.push(Step::over("bin_count", 0, each).with(LISTED_SETS[set]));
        scan(&mut steps, "bins", levels.bin_total());
        steps.push(Step::over("bin_scatter", 0, each));
        steps.push(Step::over("bin_reorder", 0, each).with(LISTED_SETS[set]));
        steps.push(Step::over("neighbour_list", 0, each));
    }
    if sort && order == Order::Classes {
        for round in 0..CLASS_ROUNDS {
            steps.push(Step::over("class_propose", round, each));
            steps.push(Step::over("class_settle", round, each));
        }
        steps.push(Step::over("class_count", 0, wide));
        steps.push(Step::over("class_starts", 0, 1));
        steps.push(Step::over("class_scatter", 0, wide));
    }
    match order {
        Order::Classes => {
            steps.extend((0..classes).map(|class| Step { workgroups: None, ..Step::over("move_particles", class, 0) }));
        }
        Order::Bins => {
            let bins = levels.levels[0].bins;
            steps.extend((0..COLOURS).map(|colour| Step::over("move_bins", colour, bins_of(colour, bins))));
        }
    }
    steps.push(Step::over("energies", 0, each));
    steps.push(Step::over("sum_blocks", 0, count.div_ceil(SUM_BLOCK)));
    steps.push(Step::over("sum_total", 0, 1));
    if density {
        for round in 1..=DELETION_ROUNDS {
            steps.push(Step::over("density_delete", round, each));
            steps.push(Step::over("density_relieve", round, each));
        }
        steps.push(Step::over("insert_propose", 0, each));
        steps.push(Step::over("insert_choose", 0, each));
        scan(&mut steps, "keep", 2 * count);
        steps.push(Step::over("compact", 0, each).with(LISTED_SETS[1 - set]));
    }
    steps
}

/// Adds the three kernels of a prefix sum. `what` is "bins" for the bin counts; any other value
/// selects the flags.
pub(crate) fn scan(steps: &mut Vec<Step>, what: &str, length: u32) {
    let (aliases, labels): (Aliases, [&'static str; 3]) = match what {
        "bins" => (
            &[("scan", "scan_bins"), ("scan_input", "bin_counts"), ("scan_output", "bin_starts")],
            ["scan_blocks of bins", "scan_sums of bins", "scan_add of bins"],
        ),
        _ => (
            &[("scan", "scan_keep"), ("scan_input", "keep"), ("scan_output", "destinations")],
            ["scan_blocks of flags", "scan_sums of flags", "scan_add of flags"],
        ),
    };
    let blocks = scan_blocks(length);
    for (k, kernel) in ["scan_blocks", "scan_sums", "scan_add"].into_iter().enumerate() {
        let workgroups = Some(if k == 1 { 1 } else { blocks });
        steps.push(Step { kernel, label: labels[k], round: 0, aliases, workgroups });
    }
}
