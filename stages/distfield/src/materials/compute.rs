//! Computes `distfield --material`: computes, surveys and checks the indicators, and fills in the
//! report.

use super::choice::{Chosen, resolve};
use super::contacts::ContactReport;
use super::cut::{survey_cut, with_planes};
use super::extract::{Extracted, MaterialOptions, Quiet, Tally, extract};
use super::grid::LabelGrid;
use super::islands::{remove_empty, remove_islands};
use super::overlaps::{Reassigned, settle};
use super::scaled::edge_length;
use super::scales::Scales;
use super::survey::{Survey, distance_limit};
use crate::args::{Args, BorderChoice};
use crate::changes::{Changes, Kind, SPECK_SHARE};
use crate::choose::ScaleArgs;
use crate::input::take_out;
use crate::labels::LABEL_ROOM;
use crate::report::{SCALED_VOLUME_LIMITS, VOLUME_LIMITS, tell_grid};
use crate::scale::{Scale, room_round};
use crate::{Border, Keep};
use isoparticles_field::materials::{MaterialId, Materials};
use isoparticles_stage::cli::values::significant;
use isoparticles_stage::cli::{Context, FIT_BUT_FOR};
use isoparticles_stage::error::{Error, Result};
use isoparticles_stage::material_sizes::{Given, GivenSize};
use isoparticles_stage::materials_file::{MaterialsFile, Shown};
use isoparticles_stage::meta::{self, MaterialsMeta, Source};
use isoparticles_volume::{Volume, VoxelBox};
use serde_json::{Map, Value, json};

/// Maximum number of materials, and of pairs of materials, in the table at the end of a run. It
/// also limits the number of materials in the warning about specks. The report contains all of
/// them.
const MOST_ROWS: usize = 12;

/// Maximum number of names listed in a warning or a failed check.
const MOST_NAMES: usize = 3;

/// Computes the indicators of the chosen materials. Also returns the checks that failed, in words.
///
/// # Errors
/// If the choices are not in the volume, an option is not supported with materials, or the run is
/// interrupted.
pub(crate) fn compute(args: &Args, mut volume: Volume, context: &Context) -> Result<(MaterialsFile, Vec<String>)> {
    check_options(args)?;
    let step = context.step("materials read");
    let mut chosen = resolve(&args.material, &volume)?;
    let overlaps = settle(&mut chosen, &volume, args.overlap);
    let base = scale(args, &volume, &chosen, context)?;
    let voxel = volume.geometry.mean_spacing();
    Given::new(&args.scale.size, &names(&chosen))?;
    let longest = scales(args, base, &chosen, voxel).map(|scales| scales.range(chosen.table.len())[1]);
    let whole = volume.geometry.padded(args.margin.into());
    let found = VoxelBox::of_labels(&volume, |label| chosen.number(label) != MaterialId::OUTSIDE.0);
    // faces of the cropped grid are treated as borders of the volume, because only the outside lies
    // beyond them
    let room = longest.map_or([LABEL_ROOM; 3], |scale| room_round(0.5 * scale / volume.geometry.spacing));
    take_out(args, &mut volume, found, room, context)?;
    let mut grid = LabelGrid::new(&volume, &chosen, args.border.of_fields(), args.margin.into());
    drop((volume, step));
    tell_overlaps(&overlaps, &mut grid, &mut chosen, context);
    remove_small(&mut grid, &mut chosen, args.smallest_island as usize, context);
    context.set_parameter("materials", json!(chosen.table));
    tell_grid(&whole, &grid.padded(), context);
    let options = MaterialOptions { clearance: args.clearance, scales: scales(args, base, &chosen, voxel) };
    let range = options.scales.as_ref().map(|scales| scales.range(chosen.table.len()));
    tell_scales(range, args, context);
    let Extracted { materials, tallies, contacts } = extract(&grid, &chosen, &options, context)?;
    let step = context.step("materials checked");
    let at_border = if args.border == BorderChoice::Flat { grid.border_planes() } else { Vec::new() };
    let materials = with_planes(materials, &args.cut, at_border)?;
    let found = survey_cut(&materials, &grid, &args.cut, context)?;
    drop(step);
    drop(grid);
    let notes = notes(&materials, &tallies, &found);
    context.report("materials", notes["table"].clone());
    context.report("interfaces", notes["interfaces"].clone());
    context.report("junctions", notes["junctions"].clone());
    context.report("voxels_changed", found.changed.iter().sum::<usize>());
    context.report("state_bytes", materials.bytes());
    describe(&materials, &tallies, &found, context);
    tell_contacts(contacts, context);
    if let Some(range) = range {
        tell_changes(&materials, &tallies, range, context);
    }

    let failed = match range {
        Some(_) => failed_at_scale(&materials, &tallies, &found, &args.scale, context),
        None => failed_checks(&materials, &tallies, &found),
    };
    let meta = MaterialsMeta {
        version: meta::VERSION,
        source: Some(Source::Labels),
        border: Some(args.border.into()),
        margin: Some(args.margin.into()),
        distance_limit: Some(distance_limit(materials.geometry())),
        scale: range.map(|[_, longest]| longest),
        notes,
    };
    let shown = Shown { material: found.material, interface_distance: found.interface_distance };
    Ok((MaterialsFile { materials, shown, meta: json!(meta), history: Some(context.history()) }, failed))
}

/// Reports the corrections of the contacts. Warns if some contacts could not be corrected.
fn tell_contacts(contacts: ContactReport, context: &Context) {
    let ContactReport { crossed, undecided, raised, left, near } = contacts;
    context.summary(
        "contacts to correct, open decisions",
        format!("{crossed}, {undecided} ({raised} samples raised, {near} margins still too small)"),
    );
    context.report("contacts", json!(contacts));
    if left > 0 {
        context.warn(format!(
            "at {left} places between grid nodes, the indicators select a material that none of the nodes has; raising \
             samples did not correct this"
        ));
    }
}

/// Reports the voxels of several materials, and removes the materials that lost all their voxels.
fn tell_overlaps(overlaps: &[Reassigned], grid: &mut LabelGrid, chosen: &mut Chosen, context: &Context) {
    let Some(Reassigned { kept, lost, voxels }) = overlaps.first() else { return };
    context.report("overlaps", json!(overlaps));
    let pairs = overlaps.len();
    context.summary("pairs of materials that overlap", pairs);
    context.warn(format!(
        "materials overlap (pairs: {pairs}; the report lists all under `overlaps`). In the largest overlap, '{kept}' \
         keeps {voxels} voxels that are also in '{lost}'. The order of MATERIALS (--material) or \
         DISTFIELD_OPTIONS=\"--overlap smaller\" chooses the material that keeps a voxel"
    ));
    let names = names(chosen);
    let is_left = remove_empty(grid, &mut chosen.table);
    let gone: Vec<String> = names.into_iter().zip(is_left).filter(|(_, left)| !left).map(|(name, _)| name).collect();
    if !gone.is_empty() {
        context.warn(format!(
            "{} materials lost all their voxels to others and were removed: {}; to keep them, list them first in \
             MATERIALS (--material)",
            gone.len(),
            listed(&gone)
        ));
    }
}

/// Merges islands into the surrounding materials and reports the islands.
fn remove_small(grid: &mut LabelGrid, chosen: &mut Chosen, least: usize, context: &Context) {
    if least < 2 {
        return;
    }
    let _step = context.step("islands");
    let found = remove_islands(grid, &mut chosen.table, least);
    let (count, voxels) = found.iter().fold((0, 0), |(n, voxels), own| (n + own.count, voxels + own.voxels));
    context.summary("islands reassigned, voxels", format!("{count}, {voxels}"));
    context.report("islands", json!(found));
    let Some(largest) = found.iter().max_by_key(|own| own.largest) else { return };
    let ([x, y, z], name, most) = (largest.place, &largest.name, largest.largest);
    context.warn(format!(
        "{count} islands of fewer than {least} voxels ({voxels} voxels in total) were merged into the surrounding \
         materials; the largest, of '{name}', has {most} voxels at ({x:.1}, {y:.1}, {z:.1}) mm (`islands` in the \
         report lists all)"
    ));
    let gone: Vec<String> = found.iter().filter(|own| own.is_all).map(|own| own.name.clone()).collect();
    if !gone.is_empty() {
        context.warn(format!(
            "{} materials consisted of such islands only and were removed: {}; to keep them, lower the number in \
             DISTFIELD_OPTIONS=\"--smallest-island VOXELS\"",
            gone.len(),
            listed(&gone)
        ));
    }
}

/// Rejects options that are not supported with several materials.
pub(crate) fn check_options(args: &Args) -> Result<()> {
    let refused = |option: &str, why: &str| {
        Err(Error::input(
            format!("{option} cannot be combined with MATERIALS (--material)"),
            format!("it applies to one object; {why}"),
            format!("leave {option} out of DISTFIELD_OPTIONS, or mesh one object with LABELS (--labels)"),
        ))
    };
    if args.keep != Keep::All {
        return refused("--keep", "--smallest-island VOXELS merges small components into the surrounding materials");
    }
    Ok(())
}

/// Returns the scale of all materials without an edge length of their own; 0 keeps every voxel
/// centre in its material.
fn scale(args: &Args, volume: &Volume, chosen: &Chosen, context: &Context) -> Result<Scale> {
    let keep_thin = args.scale.keep_thin;
    if !args.scale.is_given() {
        return Ok(Scale { length: 0.0, keep_thin });
    }
    let choice = match args.scale.choose_by_length(&volume.geometry, true) {
        Some(choice) => choice,
        None => {
            let _step = context.step("choose the scale");
            // flat borders close the materials as caps do
            let border = if args.border == BorderChoice::Open { Border::Open } else { Border::Cap };
            let mut grid = LabelGrid::new(volume, chosen, border, args.margin.into());
            let mut table = chosen.table.clone();
            remove_islands(&mut grid, &mut table, args.smallest_island as usize);
            let voxels = grid.numbers.iter().filter(|&&number| number != MaterialId::OUTSIDE.0).count();
            let named = voxels as f64 * volume.geometry.spacing.element_product();
            let found = |vertices, keep_thin| edge_length(&grid, table.len(), vertices, keep_thin, &Quiet(context));
            args.scale.choose_by_area(&volume.geometry, true, named, found)?
        }
    };
    context.summary("scale, mm", format!("{} ({})", significant(choice.length), choice.reason));
    context.set_parameter("scale", choice.length);
    context.set_parameter("scale_reason", choice.reason);
    Ok(Scale { length: choice.length, keep_thin })
}

fn names(chosen: &Chosen) -> Vec<String> {
    chosen.table.iter().map(|material| material.name.clone()).collect()
}

/// Returns the scales of all interfaces; `None` if no interface needs one. `base` is the scale
/// without `--size`, and `voxel` the mean spacing in mm. Sizes of materials that were removed have
/// no effect.
fn scales(args: &Args, base: Scale, chosen: &Chosen, voxel: f64) -> Option<Scales> {
    let names = names(chosen);
    let is_known = |size: &&GivenSize| Given::new(std::slice::from_ref(*size), &names).is_ok();
    let known: Vec<GivenSize> = args.scale.size.iter().filter(is_known).cloned().collect();
    Scales::new(base, Given::new(&known, &names).ok()?, voxel)
}

/// Reports the shortest and the longest scale (mm) that result from `--size`.
fn tell_scales(range: Option<[f64; 2]>, args: &Args, context: &Context) {
    let Some([shortest, longest]) = range.filter(|_| !args.scale.size.is_empty()) else { return };
    let [from, to] = [shortest, longest].map(significant);
    context.summary("scales of the interfaces, mm", format!("{from} to {to}"));
    context.set_parameter("scale", longest);
    context.set_parameter("scale_reason", "the longest scale of the edge lengths of materials (--size)");
}

/// Builds the notes on the materials for the output file and the report.
fn notes(materials: &Materials, tallies: &[Tally], found: &Survey) -> Map<String, Value> {
    let row = |(id, tally): (usize, &Tally)| {
        let [before, after] = tally.parts;
        let mut row = json!({
            "number": id,
            "name": materials.table()[id].name,
            "labels": materials.table()[id].labels,
            "voxels": tally.voxels,
            "volume_before": found.voxel_volumes[id],
            "volume": found.volumes[id],
            "voxels_changed": found.changed[id],
            "undecided_junctions": tally.undecided,
            "state_bytes": materials.indicators()[id].bytes(),
        });
        // the parts counted for the outside are those of the union of all other materials
        if id != MaterialId::OUTSIDE.index() {
            row["components_before"] = json!(before.components);
            row["components"] = json!(after.components);
            // with a scale, the cavities of the voxels are not counted
            row["cavities_before"] = tally.changes.as_ref().map_or(json!(before.cavities), |_| Value::Null);
            row["cavities"] = json!(after.cavities);
        }
        if let Some(changes) = &tally.changes {
            row["scale_changes"] = json!(changes);
        }
        row
    };
    let table: Vec<Value> = tallies.iter().enumerate().map(row).collect();
    [("table", json!(table)), ("interfaces", json!(found.interfaces)), ("junctions", json!(found.junctions))]
        .map(|(key, value)| (key.to_owned(), value))
        .into_iter()
        .collect()
}

fn describe(materials: &Materials, tallies: &[Tally], found: &Survey, context: &Context) {
    let name = |id: usize| materials.table()[id].name.as_str();
    let mut order: Vec<usize> = (1..tallies.len()).collect();
    order.sort_by_key(|&id| (std::cmp::Reverse(tallies[id].voxels), id));
    context.summary("number of materials", format!("{} and the outside", order.len()));
    for &id in order.iter().take(MOST_ROWS) {
        let (tally, before) = (&tallies[id], found.voxel_volumes[id]);
        let told = format!(
            "{} voxels, {} -> {} mm^3 ({:+.2} %), {} -> {} components",
            tally.voxels,
            significant(before),
            significant(found.volumes[id]),
            100.0 * (found.volumes[id] / before - 1.0),
            tally.parts[0].components,
            tally.parts[1].components,
        );
        context.summary(format!("  {}", name(id)), told);
    }
    let mut pairs: Vec<_> = found.interfaces.iter().collect();
    pairs.sort_by(|a, b| b.area.total_cmp(&a.area));
    context.summary("pairs of materials in contact", pairs.len());
    for pair in pairs.into_iter().take(MOST_ROWS) {
        let [a, b] = pair.materials.map(|id| name(id.index()));
        context.summary(format!("  {a} | {b}"), format!("{} mm^2", significant(pair.area)));
    }
    let junctions = found.junctions;
    let told = format!("{} of three, {} of four materials", junctions.edges_of_three, junctions.edges_of_four);
    context.summary("junction edges", told);
    context.summary("cells with four or more materials", junctions.corners);
    context.summary("voxel centres that changed material", found.changed.iter().sum::<usize>());
    let nodes = materials.geometry().voxel_count() as f64;
    let state = materials.bytes() as f64;
    context.summary("indicators", format!("{:.1} MiB, {:.2} bytes per node", state / 1048576.0, state / nodes));
    let is_scaled = tallies.iter().any(|tally| tally.changes.is_some());
    let lost = volumes_changed(materials, tallies, found, VOLUME_LIMITS.0);
    if !lost.is_empty() && !is_scaled {
        context.warn(format!(
            "the volumes of {} materials changed by more than {:.0} %, mostly because they are one to four voxels \
             thin or consist of specks: {}",
            lost.len(),
            100.0 * VOLUME_LIMITS.0,
            listed(&lost),
        ));
    }
}

/// Lists the materials whose volumes changed by more than the fraction `limit`, with the largest
/// material first.
fn volumes_changed(materials: &Materials, tallies: &[Tally], found: &Survey, limit: f64) -> Vec<String> {
    let mut changed: Vec<(usize, f64)> = (1..tallies.len())
        .map(|id| (id, found.volumes[id] / found.voxel_volumes[id] - 1.0))
        .filter(|(_, change)| change.abs() > limit)
        .collect();
    changed.sort_by_key(|&(id, _)| (std::cmp::Reverse(tallies[id].voxels), id));
    changed
        .into_iter()
        .map(|(id, change)| format!("'{}' {:+.0} %", materials.table()[id].name, 100.0 * change))
        .collect()
}

/// Warns about materials whose parts are split or merged or whose gaps are filled at a scale, and
/// about the losses of each material.
fn tell_changes(materials: &Materials, tallies: &[Tally], range: [f64; 2], context: &Context) {
    let [shortest, longest] = range.map(significant);
    let at_scale = if shortest == longest {
        format!("at a scale of {longest} mm,")
    } else {
        format!("at scales of {shortest} to {longest} mm,")
    };
    let changed = || {
        let names = materials.table().iter().map(|material| material.name.as_str());
        names.zip(tallies).skip(1).filter_map(|(name, tally)| Some((name, tally.changes.as_ref()?)))
    };
    for (kind, what) in [(Kind::Broken, "split parts"), (Kind::Joined, "merged parts"), (Kind::Filled, "filled gaps")] {
        let counted = changed().map(|(name, changes)| (name, changes.count(kind)));
        let named: Vec<String> =
            counted.filter(|(_, count)| *count > 0).map(|(name, count)| format!("'{name}' ({count})")).collect();
        if !named.is_empty() {
            let (count, listed) = (named.len(), listed(&named));
            context.warn(format!("{at_scale} {count} materials have {what}: {listed}; the report lists the places"));
        }
    }
    let losses = changed().filter(|(_, changes)| changes.lost() > 0.0).collect();
    tell_losses(losses, &at_scale, context);
}

/// Warns about the losses of each material at a scale. Losses below the fraction [`SPECK_SHARE`] of
/// a material are combined in one warning.
fn tell_losses(losses: Vec<(&str, &Changes)>, at_scale: &str, context: &Context) {
    let mut specks = Vec::new();
    for (name, changes) in losses {
        let counted = [(Kind::Gone, "parts"), (Kind::Shortened, "thin ends")];
        let counted = counted.map(|(kind, what)| (changes.count(kind), what)).into_iter().filter(|(n, _)| *n > 0);
        let lost = counted.map(|(count, what)| format!("{count} {what}")).collect::<Vec<_>>().join(" and ");
        let told = format!("{lost}, {} mm^3", significant(changes.lost()));
        let share = changes.lost() / changes.volume_before;
        if share < SPECK_SHARE {
            specks.push((changes.lost(), format!("'{name}' {told}")));
        } else {
            let percent = 100.0 * share;
            context.warn(format!(
                "{at_scale} '{name}' loses {told} ({percent:.2} % of its volume); the report lists the places"
            ));
        }
    }
    if specks.is_empty() {
        return;
    }
    specks.sort_by(|a, b| b.0.total_cmp(&a.0));
    let named: Vec<&str> = specks.iter().take(MOST_ROWS).map(|(_, told)| told.as_str()).collect();
    let rest = &specks[named.len()..];
    let volume: f64 = rest.iter().map(|(volume, _)| volume).sum();
    let more =
        if rest.is_empty() { String::new() } else { format!("; {} more, {} mm^3", rest.len(), significant(volume)) };
    let (percent, named) = (100.0 * SPECK_SHARE, named.join("; "));
    context.warn(format!("{at_scale} specks are lost (less than {percent:.1} % of each material): {named}{more}"));
}

/// Returns the failed checks of a run with a scale, which preserves volumes but not the materials
/// of voxel centres. Changes of volumes that the user accepts cause only a warning, which lists
/// them.
fn failed_at_scale(
    materials: &Materials,
    tallies: &[Tally],
    found: &Survey,
    scale: &ScaleArgs,
    context: &Context,
) -> Vec<String> {
    let changed = volumes_changed(materials, tallies, found, SCALED_VOLUME_LIMITS.1);
    let (count, percent) = (changed.len(), 100.0 * SCALED_VOLUME_LIMITS.1);
    let told = format!("materials whose volume the scale changed by more than {percent:.0} %");
    if changed.is_empty() {
        return Vec::new();
    }
    if scale.accept_losses {
        context.warn(format!("{FIT_BUT_FOR}{count} {told}: {}", changed.join(", ")));
        return Vec::new();
    }
    let finer = match scale.scale_for_vertices {
        Some(_) => "raise VERTICES (--scale-for-vertices)",
        None if scale.scale.is_some() => "lower SCALE (--scale)",
        None => "lower SIZE (--scale-for-size), or set SIZEFIELD_OPTIONS=\"--size NAME=MM\" to smaller edges there",
    };
    let thin = if scale.keep_thin { "" } else { ", or set DISTFIELD_OPTIONS=\"--keep-thin\"" };
    vec![format!(
        "{count} {told}: {}; many of their parts are too thin. To keep them, {finer}{thin}; to accept the losses, set \
         ACCEPT_LOSSES=yes (--accept-losses)",
        listed(&changed)
    )]
}

fn listed(names: &[String]) -> String {
    let more = if names.len() > MOST_NAMES { ", ..." } else { "" };
    format!("{}{more}", names[..names.len().min(MOST_NAMES)].join(", "))
}

/// Returns the failed checks of a run without a scale.
fn failed_checks(materials: &Materials, tallies: &[Tally], found: &Survey) -> Vec<String> {
    let mut failed = Vec::new();
    let of = |is_bad: &dyn Fn(usize) -> bool| -> Vec<String> {
        (0..tallies.len()).filter(|&id| is_bad(id)).map(|id| format!("'{}'", materials.table()[id].name)).collect()
    };
    let changed = of(&|id| found.changed[id] > 0);
    if !changed.is_empty() {
        let count: usize = found.changed.iter().sum();
        failed.push(format!("{count} voxel centres changed material, in {}", listed(&changed)));
    }
    let sides = of(&|id| tallies[id].changed > 0);
    if !sides.is_empty() {
        failed.push(format!("indicators have the wrong sign at voxel centres: {}", listed(&sides)));
    }
    let parts = of(&|id| {
        let [before, after] = tallies[id].parts;
        (before.components, before.cavities) != (after.components, after.cavities)
    });
    if !parts.is_empty() {
        failed.push(format!("indicators and voxels differ in their number of components: {}", listed(&parts)));
    }
    failed
}
