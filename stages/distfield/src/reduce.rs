//! Crops and downsamples the input, and reports the effect on the object: the number of voxels cut
//! away and of voxels at the new border, and the change in volume.

use crate::Inside;
use crate::args::Args;
use crate::input::check_kind;
use crate::materials::choice::resolve;
use crate::report::SCALED_VOLUME_LIMITS;
use isoparticles_stage::cli::Context;
use isoparticles_stage::cli::values::significant;
use isoparticles_stage::error::{Error, Result};
use isoparticles_stage::limit::check_memory;
use isoparticles_survey::input::{crop, percent};
use isoparticles_survey::kind::Kind;
use isoparticles_volume::{LayerLabel, Volume, VoxelBox};
use rayon::prelude::*;
use serde_json::{Map, Value, json};
use std::collections::BTreeMap;

/// Maximum number of parts in the table at the end of a run. The report contains all of them.
const MOST_ROWS: usize = 12;

/// Crops the volume, checks its kind, and downsamples it, according to the options.
///
/// # Errors
/// If too few voxels would remain, or if the kind of the volume does not match the options.
pub(crate) fn reduce(args: &Args, mut volume: Volume, context: &Context) -> Result<Volume> {
    if let Some(kept) = args.input.region(&volume.geometry, context)? {
        // the mask of the object has one byte per voxel
        check_memory(&args.input.path, volume.geometry.voxel_count() as u64)?;
        let step = context.step("crop");
        let cut = Parts::of(args, &volume).map(|parts| parts.cut(&volume, kept));
        drop(step);
        crop(&mut volume, kept, context);
        cut.iter().for_each(|cut| cut.tell(context));
    }
    let about_file = |error: Error| Error { what: format!("{}: {}", args.input.name(), error.what), ..error };
    check_kind(args, &volume, context).map_err(about_file)?;
    if args.input.downsample.is_some() {
        let parts = Parts::of(args, &volume);
        let before = parts.as_ref().map(|parts| parts.volumes(&volume));
        args.input.downsample(&mut volume, if args.iso.is_some() { Kind::Scan } else { Kind::Labels }, context)?;
        if let (Some(parts), Some(before)) = (parts, before) {
            parts.tell_volumes(&before, &volume, context);
        }
    }
    Ok(volume)
}

/// The parts of the object that the options select.
enum Parts {
    /// The voxels on one side of an iso value.
    Iso(f32, Inside),
    /// The names of the parts, and the number of the part of each label, from 1. A voxel can belong
    /// to several parts.
    Labels(Vec<String>, BTreeMap<LayerLabel, u16>),
}

impl Parts {
    /// Returns the parts, or `None` if a label is not in the volume. A later step reports it.
    fn of(args: &Args, volume: &Volume) -> Option<Self> {
        if let Some(iso) = args.iso {
            return Some(Self::Iso(iso as f32, args.inside));
        }
        let parts: Vec<(String, Vec<LayerLabel>)> = match &args.labels {
            Some(labels) => {
                let name =
                    |at: LayerLabel| volume.name_of(at).map_or_else(|| format!("label {}", at.label), str::to_owned);
                labels.resolve(volume).ok()?.into_iter().map(|at| (name(at), vec![at])).collect()
            }
            // the first material is the outside
            None => {
                let materials = resolve(&args.material, volume).ok()?.table.into_iter().skip(1);
                materials.map(|material| (material.name, material.labels)).collect()
            }
        };
        let (mut names, mut numbers) = (Vec::new(), BTreeMap::new());
        for (name, labels) in parts {
            names.push(name);
            let number = u16::try_from(names.len()).ok()?;
            numbers.extend(labels.into_iter().map(|at| (at, number)));
        }
        Some(Self::Labels(names, numbers))
    }

    /// Marks the voxels of all parts.
    fn mask(&self, volume: &Volume) -> Vec<bool> {
        let length = volume.geometry.size[0];
        let mut mask = vec![false; volume.geometry.voxel_count()];
        let rows = mask.par_chunks_mut(length).enumerate();
        match self {
            Self::Labels(_, numbers) => rows.for_each(|(row, mask)| {
                for (layer, voxels) in volume.layers().enumerate() {
                    let mut first = 0;
                    voxels.each_run(row * length..(row + 1) * length, |label, count| {
                        if label.is_some_and(|label| numbers.contains_key(&LayerLabel { layer, label })) {
                            mask[first..first + count].fill(true);
                        }
                        first += count;
                    });
                }
            }),
            Self::Iso(iso, inside) => rows.for_each_init(
                || vec![0.0; length],
                |values, (row, mask)| {
                    volume.voxels.copy_as_f32(row * length, values);
                    mask.iter_mut().zip(values).for_each(|(mask, value)| {
                        *mask = match inside {
                            Inside::Above => *value > *iso,
                            Inside::Below => *value < *iso,
                        }
                    });
                },
            ),
        }
        mask
    }

    /// Returns the volume of the voxels of each part, mm^3.
    fn volumes(&self, volume: &Volume) -> Vec<(String, f64)> {
        let geometry = &volume.geometry;
        let voxel = geometry.spacing.element_product() * geometry.directions.determinant().abs();
        match self {
            Self::Iso(..) => {
                let count = self.mask(volume).par_iter().filter(|&&is_inside| is_inside).count();
                vec![("the object".to_owned(), count as f64 * voxel)]
            }
            Self::Labels(names, numbers) => {
                let mut volumes: Vec<(String, f64)> = names.iter().map(|name| (name.clone(), 0.0)).collect();
                for (parts, count) in volume.combinations(|at| numbers.get(&at).copied().unwrap_or(0)) {
                    parts.iter().for_each(|&number| volumes[usize::from(number) - 1].1 += count as f64 * voxel);
                }
                volumes
            }
        }
    }

    /// Counts the voxels of the object outside the kept box, and those at each face where the box
    /// cuts through the volume.
    fn cut(&self, volume: &Volume, kept: VoxelBox) -> Cut {
        let (mask, geometry) = (self.mask(volume), &volume.geometry);
        let count = |part: VoxelBox| -> usize {
            let [x, y, z] = [0, 1, 2].map(|axis| part.low[axis]..part.high[axis] + 1);
            let of_slice = |k: usize| -> usize {
                let rows = y.clone().map(|j| geometry.linear(x.start, j, k));
                rows.map(|first| mask[first..first + x.len()].iter().filter(|&&is_inside| is_inside).count()).sum()
            };
            z.into_par_iter().map(of_slice).sum()
        };
        let all = count(VoxelBox { low: [0; 3], high: geometry.size.map(|n| n - 1) });
        let mut at_border = Vec::new();
        for (axis, [low, high]) in kept.cut_faces(geometry.size).into_iter().enumerate() {
            let (mut first, mut last) = (kept, kept);
            first.high[axis] = kept.low[axis];
            last.low[axis] = kept.high[axis];
            for (side, face, is_cut) in [("low", first, low), ("high", last, high)] {
                let found = if is_cut { count(face) } else { 0 };
                if found > 0 {
                    at_border.push((format!("{side} {}", ["x", "y", "z"][axis]), found));
                }
            }
        }
        Cut { all, away: all - count(kept), at_border }
    }

    /// Reports the change in volume of each part, and warns about large changes.
    fn tell_volumes(&self, before: &[(String, f64)], volume: &Volume, context: &Context) {
        let after = self.volumes(volume);
        let pairs = before.iter().zip(after).map(|((name, before), (_, after))| (name, *before, after));
        let changes: Vec<(&String, f64, f64)> = pairs.filter(|(_, before, _)| *before > 0.0).collect();
        for (name, before, after) in changes.iter().take(MOST_ROWS) {
            let change = 100.0 * (after / before - 1.0);
            let told = format!("{} -> {} ({change:+.2} %)", significant(*before), significant(*after));
            context.add_row(format!("  {name}, mm^3"), told);
        }
        if changes.len() > MOST_ROWS {
            context.add_row("  further parts".to_owned(), format!("{}, see --report", changes.len() - MOST_ROWS));
        }
        let is_large =
            |(_, before, after): &&(&String, f64, f64)| (after / before - 1.0).abs() > SCALED_VOLUME_LIMITS.1;
        let large: Vec<String> = changes
            .iter()
            .filter(is_large)
            .map(|(name, before, after)| format!("{name} ({:+.0} %)", 100.0 * (after / before - 1.0)))
            .collect();
        if !large.is_empty() {
            context.warn(format!(
                "--downsample changes the volume by more than {:.0} %: {}; choose a smaller number",
                100.0 * SCALED_VOLUME_LIMITS.1,
                large.join(", ")
            ));
        }
        let rows =
            changes.iter().map(|(name, before, after)| json!({ "name": name, "before": before, "after": after }));
        context.report("downsample_volumes", rows.collect::<Vec<_>>());
    }
}

/// Effect of cropping on the object, in voxels.
struct Cut {
    /// Voxels of the object in the whole volume.
    all: usize,
    /// Of these, the voxels that are cut away.
    away: usize,
    /// Name of each face that cuts the object, and the number of object voxels at this face.
    at_border: Vec<(String, usize)>,
}

impl Cut {
    fn tell(&self, context: &Context) {
        let Self { all, away, at_border } = self;
        if *all > 0 {
            let share = percent(*away as f64 / *all as f64);
            context.add_row("  object cut away, voxels".to_owned(), format!("{away} of {all} ({share})"));
        }
        let listed: Vec<String> = at_border.iter().map(|(face, count)| format!("{face} {count}")).collect();
        let told = if listed.is_empty() { "none".to_owned() } else { listed.join(", ") };
        context.add_row("  object at the new border, voxels".to_owned(), told);
        let at_border: Map<String, Value> =
            at_border.iter().map(|(face, count)| (face.clone(), json!(count))).collect();
        context.report("crop_object", json!({ "voxels": all, "cut_away": away, "at_new_border": at_border }));
    }
}
