//! Formats the description of a volume for `isoparticles-volume info`.

use crate::cost::{Cost, FEWEST_VERTICES, UNCERTAINTY, Uniform};
use crate::extent::WorldBox;
use crate::kind::Kind;
use crate::selection::MOST_LISTED;
use crate::{LabelInfo, Object, VolumeInfo};
use isoparticles_volume::Space;
use std::fmt::Write;

/// Maximum number of rows of the histogram. Sixteen rows divide the 256 bins evenly and fit on a
/// screen of 24 lines.
const ROWS: usize = 16;

/// Length of the longest bar of the histogram in characters. With the 27 characters before the bar,
/// a row fits in 80 columns.
const BAR: f64 = 40.0;

impl VolumeInfo {
    /// Returns the description as several lines of text. The first line is `name`, the name of the
    /// volume.
    pub fn text(&self, name: &str) -> String {
        // writing to a String cannot fail
        let mut out = String::new();
        let _ = self.write(name, &mut out);
        out
    }

    fn write(&self, name: &str, out: &mut String) -> std::fmt::Result {
        let [nx, ny, nz] = self.size;
        let [sx, sy, sz] = self.spacing.map(short);
        let [ex, ey, ez] = self.extent.map(short);
        let voxels = grouped(self.size.iter().product());
        writeln!(out, "{name}")?;
        writeln!(out, "  size         {nx} x {ny} x {nz} = {voxels} voxels of {}", self.scalar_type)?;
        writeln!(out, "  spacing      {sx} x {sy} x {sz} mm, the whole {ex} x {ey} x {ez} mm")?;
        self.write_orientation(out)?;
        let doubt = if self.judgement.certain { "" } else { " (a guess)" };
        writeln!(out, "  kind         {}{doubt}: {}", self.judgement.kind, self.judgement.reason)?;
        self.write_values(out)?;
        for remark in &self.remarks {
            writeln!(out, "  remark       {remark}")?;
        }
        if self.judgement.kind == Kind::Scan {
            self.write_histogram(out)?;
        } else {
            self.write_labels(out)?;
        }
        self.write_objects(out)
    }

    fn write_orientation(&self, out: &mut String) -> std::fmt::Result {
        let [x, y, z] = &self.orientation.axes;
        let letters = self.orientation.letters.as_ref().map_or_else(String::new, |letters| format!(" ({letters})"));
        let unnamed = if self.space == Space::Unnamed { "; the file names no anatomical space" } else { "" };
        let handed = if self.orientation.left_handed { "left-handed" } else { "right-handed" };
        let oblique = match self.orientation.oblique_degrees {
            angle if angle < 0.05 => "along the axes of the world".to_owned(),
            angle => format!("oblique by {angle:.1} degrees"),
        };
        let sheared = if self.orientation.sheared { ", axes not at right angles" } else { "" };
        writeln!(out, "  orientation  x {x}, y {y}, z {z}{letters}; {oblique}, {handed}{sheared}{unnamed}")
    }

    fn write_values(&self, out: &mut String) -> std::fmt::Result {
        let range = match self.values.range {
            Some([low, high]) => format!("{} to {}", short(low), short(high)),
            None => "no number at all".to_owned(),
        };
        let distinct = match self.distinct {
            Some(distinct) => format!(", {distinct} distinct"),
            None => String::new(),
        };
        let bad = match self.values.non_finite {
            0 => String::new(),
            count => format!(", {} voxels NaN or infinite", grouped(count)),
        };
        let unit = if self.hounsfield { ", Hounsfield units by the look of it" } else { "" };
        writeln!(out, "  values       {range}{distinct}{unit}{bad}")
    }

    fn write_histogram(&self, out: &mut String) -> std::fmt::Result {
        let histogram = &self.values.histogram;
        let total: usize = histogram.counts.iter().sum();
        let bins = histogram.counts.len().div_ceil(ROWS).max(1);
        let rows: Vec<usize> = histogram.counts.chunks(bins).map(|bins| bins.iter().sum()).collect();
        let most = rows.iter().copied().max().unwrap_or(0).max(1);
        writeln!(out, "\n  from             share  (bars: square root of the share)")?;
        for (n, &count) in rows.iter().enumerate() {
            let low = histogram.low + (n * bins) as f64 * histogram.width;
            let share = 100.0 * count as f64 / total.max(1) as f64;
            let bar = "#".repeat((BAR * (count as f64 / most as f64).sqrt()).round() as usize);
            writeln!(out, "{}", format!("  {:>12}  {share:7.3} %  {bar}", short(low)).trim_end())?;
        }
        Ok(())
    }

    fn write_labels(&self, out: &mut String) -> std::fmt::Result {
        let mut labels: Vec<&LabelInfo> = self.labels.iter().collect();
        let left_out = labels.len().saturating_sub(MOST_LISTED);
        if left_out > 0 {
            labels.sort_by_key(|label| std::cmp::Reverse(label.voxels));
            labels.truncate(MOST_LISTED);
        }
        let layer = if self.layers > 1 { "  layer" } else { "" };
        writeln!(out, "\n    label{layer}        voxels          mm^3    parts    vertices  name")?;
        for label in &labels {
            let layer = if self.layers > 1 { format!("  {:>5}", label.at.layer) } else { String::new() };
            let parts = label.parts.map_or_else(|| "many".to_owned(), |parts| grouped(parts.count));
            let line = format!(
                "  {:>7}{layer}  {:>12}  {:>12}  {parts:>7}  {:>10}  {}",
                label.at.label,
                grouped(label.voxels),
                short(label.volume),
                grouped(label.vertices),
                label.name.as_deref().unwrap_or(""),
            );
            writeln!(out, "{}", line.trim_end())?;
        }
        if left_out > 0 {
            writeln!(out, "  and {left_out} smaller ones (--json FILE has all)")?;
        }
        self.write_overlaps(out)?;
        self.write_boxes(&labels, out)
    }

    fn write_overlaps(&self, out: &mut String) -> std::fmt::Result {
        let name = |n: usize| {
            let LabelInfo { at, name, .. } = &self.labels[n];
            name.clone().unwrap_or_else(|| format!("{} of layer {}", at.label, at.layer))
        };
        if !self.overlaps.is_empty() {
            writeln!(out, "\n  overlaps        voxels  of ({} pairs)", self.overlaps.len())?;
        }
        for overlap in self.overlaps.iter().take(MOST_LISTED) {
            let [a, b] = overlap.labels.map(name);
            writeln!(out, "            {:>12}  {a} and {b}", grouped(overlap.voxels))?;
        }
        Ok(())
    }

    /// Writes the bounding box of each label and its centre in world coordinates, for use in
    /// options that take world positions.
    fn write_boxes(&self, labels: &[&LabelInfo], out: &mut String) -> std::fmt::Result {
        if labels.iter().all(|label| label.bounds.is_none()) {
            return Ok(());
        }
        let frame = self.space.name().map_or_else(String::new, |name| format!(", {name}"));
        writeln!(out, "\n    label  box and its centre in world coordinates (mm{frame})")?;
        for label in labels {
            let Some(WorldBox { low, high, centre }) = label.bounds else { continue };
            let range = |a: usize| format!("{} {} to {}", ["x", "y", "z"][a], short(low[a]), short(high[a]));
            let (ranges, centre) = ([0, 1, 2].map(range).join(", "), centre.map(short).join(", "));
            let layer = if self.layers > 1 { format!("  layer {}", label.at.layer) } else { String::new() };
            writeln!(out, "  {:>7}{layer}  {ranges}; centre ({centre})", label.at.label)?;
        }
        Ok(())
    }

    fn write_objects(&self, out: &mut String) -> std::fmt::Result {
        if self.objects.is_empty() {
            return Ok(());
        }
        writeln!(out, "\n  cost of a mesh (vertices within a factor of {UNCERTAINTY})")?;
        for object in &self.objects {
            write_object(object, out)?;
        }
        writeln!(
            out,
            "  Time is the processor time of all threads; docs/user/size.md gives the rates and their machine."
        )
    }
}

fn write_object(object: &Object, out: &mut String) -> std::fmt::Result {
    let parts = match object.parts {
        Some(parts) if parts.count == 1 => "1 part".to_owned(),
        Some(parts) => format!("{} parts", grouped(parts.count)),
        None => "very many parts".to_owned(),
    };
    writeln!(out, "\n  {}  ({})", object.options, object.why)?;
    writeln!(out, "    {}: {} voxels, {} mm^3, {parts}", object.what, grouped(object.voxels), short(object.volume))?;
    let Some(Cost { area, vertices, vertices_range: [low, high], uniform, stages }) = &object.cost else {
        return writeln!(out, "    no surface");
    };
    let sizes: Vec<String> =
        uniform.iter().map(|one| format!("SIZE={} {}", short(one.size), grouped(one.vertices))).collect();
    writeln!(out, "    area {} mm^2", short(*area))?;
    writeln!(
        out,
        "    vertices {} ({} to {}); {}{}",
        grouped(*vertices),
        grouped(*low),
        grouped(*high),
        sizes.join(", "),
        fewest_told(object.parts.map_or(1, |parts| parts.count), uniform)
    )?;
    let told: Vec<String> = stages
        .iter()
        .map(|stage| {
            format!(
                "{} {} s, {} MiB",
                stage.stage,
                short(two(stage.seconds)),
                grouped((stage.bytes / 1048576.0) as usize)
            )
        })
        .collect();
    writeln!(out, "    {}", told.join("; "))
}

/// Returns a note that each part has a minimum number of vertices, which explains equal vertex
/// counts for different edge lengths. The note is empty if the minimum does not apply.
fn fewest_told(parts: usize, uniform: &[Uniform]) -> String {
    let fewest = two(FEWEST_VERTICES * parts as f64) as usize;
    if parts < 2 || uniform.iter().all(|one| one.vertices > fewest) {
        return String::new();
    }
    format!(" (at least {FEWEST_VERTICES} vertices for each of {} parts)", grouped(parts))
}

fn two(value: f64) -> f64 {
    crate::cost::two_digits(value)
}

/// Formats a number with up to six significant digits, without trailing zeros.
fn short(value: f64) -> String {
    if value == 0.0 || !value.is_finite() {
        return format!("{value}");
    }
    let digits = (5 - value.abs().log10().floor() as i32).clamp(0, 9) as usize;
    let text = format!("{value:.digits$}");
    if text.contains('.') { text.trim_end_matches('0').trim_end_matches('.').to_owned() } else { text }
}

/// Formats an integer with commas between groups of three digits.
fn grouped(value: usize) -> String {
    let digits = value.to_string();
    let mut out = String::new();
    for (n, digit) in digits.chars().enumerate() {
        if n > 0 && (digits.len() - n).is_multiple_of(3) {
            out.push(',');
        }
        out.push(digit);
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_read_well() {
        assert_eq!(
            ["0", "999", "1,000", "1,234,567"],
            [0, 999, 1000, 1_234_567].map(grouped).each_ref().map(String::as_str)
        );
        assert_eq!(
            ["0", "1.5", "0.0195", "-1024", "1234567", "0.521484"],
            [0.0, 1.5, 0.0195, -1024.0, 1_234_567.0, 0.521_484].map(short).each_ref().map(String::as_str)
        );
    }
}
