//! Composes the source of each kernel: declarations of the Rust constants, the shared pieces that
//! the kernel uses, and the kernel's own file.

use super::constants::declarations;

/// Parts of a kernel.
pub(crate) struct Source {
    /// Name of the kernel, which is also the name of its file.
    pub name: &'static str,
    /// Shared pieces, in order.
    pieces: &'static [Piece],
    text: &'static str,
}

/// A shared piece. The source of every piece except `Text` depends on the adapter or on the kind of
/// surface.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Piece {
    Text(&'static str),
    /// Access to the fields, in one or four slabs.
    Fields,
    /// Sums over the lanes of a team.
    Team,
    /// Data stored with the normal, for one object or many materials.
    Carried,
    /// Coefficients of F, or of the differences between indicators.
    Nodes,
}

/// Properties of the adapter and of the surface that determine the source of the pieces.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Variant {
    /// True if the fields are split into slabs.
    pub slabs: bool,
    /// Number of lanes of a team if sums use subgroup operations; `None` if they use workgroup
    /// memory.
    pub subgroup_team: Option<u32>,
    /// True if the run has many materials.
    pub materials: bool,
}

impl Variant {
    /// Returns the number of lanes per team and the number of teams per workgroup.
    pub(crate) fn team(self) -> (u32, u32) {
        // a team that sums through workgroup memory is a whole workgroup; otherwise several teams
        // share a workgroup of 128 lanes
        self.subgroup_team.map_or((32, 1), |lanes| (lanes, 128 / lanes))
    }
}

const PARAMETERS: Piece = Piece::Text(include_str!("../../../../shaders/shared/parameters.wgsl"));
const ENERGY: Piece = Piece::Text(include_str!("../../../../shaders/shared/energy.wgsl"));
const PLANE: Piece = Piece::Text(include_str!("../../../../shaders/shared/plane.wgsl"));
const RANDOM: Piece = Piece::Text(include_str!("../../../../shaders/shared/random.wgsl"));
const GRID: Piece = Piece::Text(include_str!("../../../../shaders/shared/grid.wgsl"));
const SPLINE: Piece = Piece::Text(include_str!("../../../../shaders/shared/spline.wgsl"));
const PROJECT: Piece = Piece::Text(include_str!("../../../../shaders/shared/project.wgsl"));
const TEAM_SURFACE: Piece = Piece::Text(include_str!("../../../../shaders/shared/team_surface.wgsl"));
const LEVELS: Piece = Piece::Text(include_str!("../../../../shaders/shared/levels.wgsl"));
const LISTS: Piece = Piece::Text(include_str!("../../../../shaders/shared/lists.wgsl"));
const LIST_TILES: Piece = Piece::Text(include_str!("../../../../shaders/shared/list_tiles.wgsl"));
const WALK: Piece = Piece::Text(include_str!("../../../../shaders/shared/neighbour_walk.wgsl"));
const CLASSES: Piece = Piece::Text(include_str!("../../../../shaders/shared/classes.wgsl"));
const NEWTON: Piece = Piece::Text(include_str!("../../../../shaders/shared/newton.wgsl"));
const TEAM_ENERGY: Piece = Piece::Text(include_str!("../../../../shaders/shared/team_energy.wgsl"));
const TEAM_MOVE: Piece = Piece::Text(include_str!("../../../../shaders/shared/team_move.wgsl"));
const DENSITY: Piece = Piece::Text(include_str!("../../../../shaders/shared/density.wgsl"));
const TOTALS: Piece = Piece::Text(include_str!("../../../../shaders/shared/totals.wgsl"));
const SCAN: Piece = Piece::Text(include_str!("../../../../shaders/shared/scan.wgsl"));
const ROUND: Piece = Piece::Text(include_str!("../../../../shaders/shared/round.wgsl"));

macro_rules! source {
    ($name:literal, $pieces:expr) => {
        Source { name: $name, pieces: $pieces, text: include_str!(concat!("../../../../shaders/", $name, ".wgsl")) }
    };
}

/// All kernels except those of the tests.
const SOURCES: &[Source] = &[
    source!("begin_pass", &[]),
    source!("scan_blocks", &[SCAN]),
    source!("scan_sums", &[SCAN]),
    source!("scan_add", &[SCAN]),
    source!("bin_count", &[PARAMETERS, LEVELS]),
    source!("bin_scatter", &[PARAMETERS]),
    source!("bin_reorder", &[PARAMETERS, Piece::Carried]),
    source!("neighbour_list", &[PARAMETERS, LIST_TILES, LEVELS, Piece::Carried, WALK]),
    source!("class_propose", &[PARAMETERS, RANDOM, LIST_TILES, LISTS, ROUND, CLASSES]),
    source!("class_settle", &[PARAMETERS, RANDOM, LIST_TILES, LISTS, ROUND, CLASSES]),
    source!("class_count", &[PARAMETERS, RANDOM, CLASSES]),
    source!("class_starts", &[PARAMETERS, RANDOM, CLASSES]),
    source!("class_scatter", &[PARAMETERS, RANDOM, CLASSES]),
    source!(
        "move_particles",
        &[
            PARAMETERS,
            Piece::Fields,
            GRID,
            SPLINE,
            Piece::Carried,
            Piece::Nodes,
            Piece::Team,
            TEAM_SURFACE,
            PROJECT,
            ENERGY,
            PLANE,
            LIST_TILES,
            LISTS,
            TEAM_ENERGY,
            NEWTON,
            TEAM_MOVE,
            ROUND
        ]
    ),
    source!(
        "move_bins",
        &[
            PARAMETERS,
            Piece::Fields,
            GRID,
            SPLINE,
            Piece::Carried,
            Piece::Nodes,
            Piece::Team,
            TEAM_SURFACE,
            PROJECT,
            ENERGY,
            PLANE,
            LIST_TILES,
            LISTS,
            TEAM_ENERGY,
            NEWTON,
            TEAM_MOVE,
            LEVELS,
            ROUND
        ]
    ),
    source!("energies", &[PARAMETERS, ENERGY, LIST_TILES, LISTS, Piece::Carried]),
    source!("sum_blocks", &[PARAMETERS, TOTALS]),
    source!("sum_total", &[PARAMETERS, TOTALS]),
    source!("density_delete", &[PARAMETERS, RANDOM, DENSITY, LIST_TILES, LISTS, ROUND]),
    source!("density_relieve", &[PARAMETERS, ENERGY, LIST_TILES, LISTS, ROUND]),
    source!(
        "insert_propose",
        &[
            PARAMETERS,
            Piece::Fields,
            GRID,
            SPLINE,
            Piece::Carried,
            Piece::Nodes,
            Piece::Team,
            TEAM_SURFACE,
            PROJECT,
            PLANE,
            RANDOM,
            DENSITY,
            LIST_TILES,
            LISTS
        ]
    ),
    source!("insert_choose", &[PARAMETERS, RANDOM, LEVELS, LIST_TILES, LISTS, Piece::Carried]),
    source!("compact", &[PARAMETERS]),
];

/// Test kernels, which write the results of the shared pieces to buffers.
#[cfg(test)]
pub(crate) const PROBES: &[Source] = &[
    source!(
        "tests/probe_fields",
        &[PARAMETERS, Piece::Fields, GRID, SPLINE, Piece::Carried, Piece::Nodes, Piece::Team, TEAM_SURFACE, PROJECT]
    ),
    source!(
        "tests/probe_jets",
        &[
            PARAMETERS,
            Piece::Fields,
            GRID,
            SPLINE,
            Piece::Carried,
            Piece::Nodes,
            Piece::Team,
            TEAM_SURFACE,
            ENERGY,
            PLANE,
            LIST_TILES,
            LISTS,
            TEAM_ENERGY
        ]
    ),
];
#[cfg(not(test))]
const PROBES: &[Source] = &[];

/// Returns all kernels. In test builds, these include the test kernels.
pub(crate) fn sources() -> impl Iterator<Item = &'static Source> {
    SOURCES.iter().chain(PROBES)
}

impl Source {
    /// Returns the variant for this kernel. In `move_bins` a workgroup is one team of 32 lanes that
    /// processes a bin. The particles of the bin move one after the other, so the pass is faster
    /// with more lanes per particle.
    pub(crate) fn variant(&self, variant: Variant) -> Variant {
        match self.name {
            "move_bins" => Variant { subgroup_team: variant.subgroup_team.map(|_| 32), ..variant },
            _ => variant,
        }
    }

    /// Returns the complete source for a variant.
    pub(crate) fn compose(&self, variant: Variant) -> String {
        let variant = self.variant(variant);
        let mut text = declarations(variant.team());
        for piece in self.pieces {
            let piece = match piece {
                Piece::Text(text) => text,
                Piece::Fields if variant.slabs => include_str!("../../../../shaders/shared/fields_4.wgsl"),
                Piece::Fields => include_str!("../../../../shaders/shared/fields_1.wgsl"),
                Piece::Team => match variant.subgroup_team {
                    Some(_) => include_str!("../../../../shaders/shared/team_subgroups.wgsl"),
                    None => include_str!("../../../../shaders/shared/team_memory.wgsl"),
                },
                Piece::Carried if variant.materials => {
                    include_str!("../../../../shaders/shared/carried_materials.wgsl")
                }
                Piece::Carried => include_str!("../../../../shaders/shared/carried_object.wgsl"),
                Piece::Nodes if variant.materials => include_str!("../../../../shaders/shared/nodes_materials.wgsl"),
                Piece::Nodes => include_str!("../../../../shaders/shared/nodes_object.wgsl"),
            };
            text.push_str(piece);
            text.push('\n');
        }
        text.push_str(self.text);
        text
    }
}

/// A buffer that a kernel uses.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct Binding {
    /// Binding number in group 0.
    pub number: u32,
    /// Name of both the variable and the buffer.
    pub name: String,
    /// Access to the buffer.
    pub access: Access,
}

/// Access of a kernel to a buffer.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Access {
    Uniform,
    Read,
    ReadWrite,
}

/// Returns the buffers that a source declares. Parses lines of the form `@group(0) @binding(n)
/// var<...> name: type;`.
pub(crate) fn bindings(text: &str) -> Vec<Binding> {
    text.lines()
        .filter_map(|line| {
            let rest = line.strip_prefix("@group(0) @binding(")?;
            let (number, rest) = rest.split_once(") var<")?;
            let (space, rest) = rest.split_once("> ")?;
            let (name, _) = rest.split_once(':')?;
            let access = match space {
                "uniform" => Access::Uniform,
                "storage, read" => Access::Read,
                _ => Access::ReadWrite,
            };
            Some(Binding { number: number.parse().ok()?, name: name.to_owned(), access })
        })
        .collect()
}
