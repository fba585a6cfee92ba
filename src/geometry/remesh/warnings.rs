//! What a caller should know of a remesh that succeeded: data that changed or was dropped, and requests that were missed.
//!
//! Purpose: [`of`] reads the figures of a report and what the input carries, and makes warnings; readers and writers of files add theirs by
//! `Warning::left_aside` and `Warning::not_held`. Invariant: each condition has one code, which does not change, and one
//! sentence, made here, with names of options in backticks; every interface shows the same list. Must not know: how the figures
//! came about, where warnings are shown.

use super::RemeshOptions;
use super::report::{CountReason, LostReason, RefineEnd, RegionFigures, Report, Warning};
use crate::mesh::attributes::{Attributes, Colours};
use crate::mesh::duplicates::InputKind;

/// How far from symmetric an input may be, percent of its diagonal.
const ASYMMETRIC_PERCENT: f64 = 0.01;
/// The most regions that are named.
const MOST_NAMED: usize = 10;

/// The warnings of a remesh with `options`, those of the input first.
pub(super) fn of(report: &Report, options: &RemeshOptions) -> Vec<Warning> {
    let mut all = Vec::new();
    of_input(report, options.keep_non_manifold, &mut all);
    let colours = options.attributes.as_ref().and_then(Attributes::colours).map_or(0, Colours::outside);
    let outside = "numbers of colours are neither from 0 to 1 nor, with all others, from 0 to 255; they stay as they are, and \
                   formats with bytes cut them";
    counted(&mut all, "colours_out_of_range", colours, outside);
    of_count(report, &mut all);
    of_kept(report, &mut all);
    of_symmetry(report, &mut all);
    of_repair(report, &mut all);
    of_lost(report, &mut all);
    of_shape(report, &mut all);
    let away = "facets of the result face away from the input, which bends within an edge of the metric; give a metric with shorter \
                edges there";
    counted(&mut all, "metric_too_coarse", report.result.metric.map_or(0, |metric| metric.facing_away), away);
    all
}

/// A warning about `count` elements, if there are any.
fn counted(all: &mut Vec<Warning>, code: &'static str, count: usize, text: &str) {
    if count > 0 {
        all.push(Warning::new(code, Some(count), format!("{count} {text}")));
    }
}

fn of_input(report: &Report, keeps_non_manifold: bool, all: &mut Vec<Warning>) {
    let input = &report.input;
    let stitched = "vertices of the input's boundaries were nearly in the same place as others and moved there";
    counted(all, "stitched_vertices", input.stitched_vertices, stitched);
    let divided = "boundary edges of the input had vertices of others on them and were divided there";
    counted(all, "divided_edges", input.divided_edges, divided);
    if input.gap_edges > 0 {
        let (gap, weld) = (input.gap_distance, input.gap_weld);
        let joins = match (weld > 0.0, input.gap_edges_left) {
            (false, _) => "no distance for `weld` joins them without facets that vanish".to_owned(),
            (true, 0) => format!("`weld` of {weld:.2e} joins them"),
            (true, left) => format!("`weld` of {weld:.2e} joins all but {left}"),
        };
        let text = format!("{} boundary edges of the input have others up to {gap:.3e} away; {joins}", input.gap_edges);
        all.push(Warning::new("gap_edges", Some(input.gap_edges), text));
    }
    let outliers = "vertices of the input are far from all others, and most points go to the spikes there; check their \
                    coordinates";
    counted(all, "outlier_vertices", input.outlier_vertices, outliers);
    counted(all, "degenerate_facets", input.degenerate_facets, "facets of the input have no area and do not count");
    let coincident = "facets of the input lay on others, corner on corner, and were left out";
    counted(all, "coincident_facets", input.coincident_facets, coincident);
    let turned = "facets of the input were oriented unlike their neighbours and turned over";
    counted(all, "reoriented_facets", input.reoriented_facets, turned);
    if input.kind == InputKind::Volume {
        let text =
            "facets of the input lie between others: this is a mesh of a volume, no surface; remesh its boundary";
        counted(all, "enclosed_facets", input.enclosed_facets, text);
        return;
    }
    let backs = "facets of the input lie on others, back to back, and enclose nothing; remesh one side of them";
    counted(all, "back_to_back_facets", input.back_to_back_facets, backs);
    let few = input.points_for_sheets;
    if few > 0 {
        let text = format!(
            "the input's parts touch, and points are too few to keep them apart, so that some may be joined or lost; from {few} points on \
             each has its own"
        );
        all.push(Warning::new("few_points_for_sheets", Some(few), text));
    } else if report.result.topology.non_manifold_edges == 0 && !keeps_non_manifold {
        let edges =
            "edges of the input have more than two facets; the result is cut there; `non_manifold` keep joins it";
        counted(all, "non_manifold_edges", input.topology.non_manifold_edges, edges);
    } else if report.result.topology.non_manifold_edges == 0 {
        let edges =
            "edges of the input have more than two facets, and none of the result has; more points may keep them";
        counted(all, "non_manifold_edges", input.topology.non_manifold_edges, edges);
    }
}

/// Vertices and curves that there are more or fewer of than was asked for.
fn of_count(report: &Report, all: &mut Vec<Warning>) {
    let count = report.vertex_count;
    if let Some(reason) = count.reason {
        let why = match reason {
            CountReason::GivenSeeds => "seeds are given, and none is left out or added",
            CountReason::Parts => "the input has so many parts that they need more",
            CountReason::CloseSheets => "sheets or parts are nearer to each other than an edge is long",
            CountReason::SmallParts => {
                "parts of the input are too small for a facet and were left out; more points keep them"
            }
            CountReason::NoThickness => "parts of the input have no thickness",
            CountReason::NarrowPatches => "what lies between its creases is narrower than an edge",
            CountReason::FewPoints => {
                "with so few points it would be folded, cross itself, have another topology, be far from the input or lack creases"
            }
            CountReason::Metric => "edges of the metric's lengths need another number",
        };
        let (asked, vertices) = (count.asked, report.result.vertices);
        let asked = match report.refine.ended {
            Some(_) => format!("there are {asked} points"),
            None => format!("{asked} vertices were asked for"),
        };
        let text = format!("{asked}, and the result has {vertices} vertices: {why}");
        all.push(Warning::new("vertex_count", Some(vertices), text));
    }
    let features = &report.features;
    if let Some(longest) = features.dropped.first() {
        let curves = features.boundaries + features.creases + features.dropped_curves;
        let [x, y, z] = longest.place;
        let text = format!(
            "{} of {curves} creases and boundaries were dropped, {:.4} long in all, the longest of {:.4} at {x:.4} {y:.4} {z:.4}: they are \
             too close together for so few points; more points keep more",
            features.dropped_curves, features.dropped_length, longest.length
        );
        let places = features.dropped.iter().map(|curve| curve.place).collect();
        all.push(Warning { places, ..Warning::new("dropped_curves", Some(features.dropped_curves), text) });
    }
    let broken = "edges of creases or boundaries are missing in the result; more points may keep them";
    counted(all, "missing_curve_edges", features.missing_segments, broken);
    let short = "sharp edges of the input are in creases shorter than eight edges of the result, which were not kept; more points keep them";
    let edges = if features.is_designed { features.short_crease_edges } else { 0 };
    counted(all, "short_creases", edges, short);
}

/// What stayed though it need not.
fn of_kept(report: &Report, all: &mut Vec<Warning>) {
    let further = "facets beside those that stay had to stay too, so that all edges meet; more points make them fewer";
    if report.result.kept.is_some_and(|kept| kept.facets + kept.rim_edges + kept.single_vertices == 0) {
        let text = "nothing of the input is in what is to stay; check coordinates and units";
        all.push(Warning::new("nothing_kept", None, text.to_owned()));
    }
    counted(all, "further_kept", report.result.kept.map_or(0, |kept| kept.further_facets), further);
}

/// An input that is less symmetric, or less periodic, than its result.
fn of_symmetry(report: &Report, all: &mut Vec<Warning>) {
    let percent = report.result.mirror.map_or(0.0, |mirror| mirror.asymmetry_percent);
    if percent > ASYMMETRIC_PERCENT {
        let text = format!(
            "the half of the input behind the mirror plane is up to {percent:.2} % of the diagonal away from the mirror \
             image of the other; check the plane, or remesh it without one"
        );
        all.push(Warning::new("asymmetric", None, text));
    }
    let unpaired = "boundary edges of the input are within reach of a motion of others, and none of these is the same; they are not \
                    periodic in the result; check the numbers of the motion";
    counted(all, "unpaired_edges", report.result.periodic.map_or(0, |periodic| periodic.unpaired_edges), unpaired);
}

/// What the repair of the dual removed or doubled.
fn of_repair(report: &Report, all: &mut Vec<Warning>) {
    let repair = &report.result.repair;
    let why = match report.input.kind {
        InputKind::Surface => "the surface is thinner than an edge there; more points keep more",
        _ => "the input is no manifold there; cut it where its parts meet, or give more points",
    };
    let pairs = format!("pairs of facets lay back to back and were removed: {why}");
    counted(all, "closed_facet_pairs", repair.closed_facet_pairs, &pairs);
    let surplus = format!("facets were too many at an edge and were removed: {why}");
    counted(all, "non_manifold_facets", repair.non_manifold_facets, &surplus);
    let touching =
        "vertices of the result are in the place of others, where parts touch; join no vertices by their places";
    counted(all, "coincident_vertices", report.result.coincident_vertices, touching);
    let (without, extra) = (repair.seeds_without_vertex, repair.extra_vertices);
    if without + extra > 0 {
        let counts = [(without, "points have no vertex"), (extra, "vertices share the point of another")];
        let counts = counts.into_iter().filter(|(count, _)| *count > 0).map(|(count, what)| format!("{count} {what}"));
        let text = format!("{}: the surface is thin there", counts.collect::<Vec<_>>().join(", "));
        all.push(Warning::new("shared_points", Some(without + extra), text));
    }
}

/// Parts and regions of the input that the result lacks.
fn of_lost(report: &Report, all: &mut Vec<Warning>) {
    let lost: Vec<&RegionFigures> = report.result.regions.iter().filter(|region| region.facets == 0).collect();
    if !lost.is_empty() {
        let label = |region: &&RegionFigures| match &region.name {
            name if name.is_empty() => region.number.to_string(),
            name => format!("{name:?}"),
        };
        let labels: Vec<String> = lost.iter().take(MOST_NAMED).map(label).collect();
        let more = if lost.len() > MOST_NAMED { ", ..." } else { "" };
        let (count, labels) = (lost.len(), labels.join(", "));
        let text =
            format!("{count} regions are smaller than a facet and were lost: {labels}{more}; more points keep them");
        all.push(Warning::new("lost_regions", Some(count), text));
    }
    let Some(lost) = report.result.lost.as_ref().filter(|lost| lost.count > 0) else { return };
    let mut text = format!(
        "{} parts of the input, {:.2} % of its area, are farther than an edge from the result",
        lost.count, lost.area_percent
    );
    if let Some(largest) = lost.parts.first() {
        let [x, y, z] = largest.place;
        let why = match largest.reason {
            LostReason::Component => {
                "a component of its own, too small for its share of points; remove it, or give more points"
            }
            LostReason::NonManifold => "it hangs on an edge of more than two facets; cut it off, or give more points",
            LostReason::Boundary => "narrower than an edge, at a boundary; more points keep it, or close the hole",
            LostReason::Thin => "thinner than an edge; more points keep it",
        };
        let (area, far) = (largest.area_percent, largest.distance_percent);
        text += &format!(
            "; the largest, {area:.3} % of the area, is {far:.2} % of the diagonal away at {x:.4} {y:.4} {z:.4}: {why}"
        );
    }
    let places = lost.parts.iter().map(|part| part.place).collect();
    all.push(Warning { places, ..Warning::new("lost_parts", Some(lost.count), text) });
}

/// Lengths, topology and distance that are not as asked for.
fn of_shape(report: &Report, all: &mut Vec<Warning>) {
    let noise = report.density.noise_percent;
    if noise > 0.0 {
        let text = format!(
            "{noise:.0} % of the surface had lengths that no triangles can follow; they were evened out between neighbours; \
             smooth them, or give a lower `gradation`"
        );
        all.push(Warning::new("uneven_lengths", None, text));
    }
    if !report.topology_changes.is_empty() {
        let odd = report.input.topology.non_manifold_edges + report.input.topology.non_manifold_vertices > 0;
        let why = if odd { "the input is no manifold, as the result is" } else { "more points keep more" };
        let text = format!("the topology changed: {}; {why}", report.topology_changes.join(", "));
        all.push(Warning::new("topology_changed", None, text));
    }
    if let Some(crossings) = report.result.crossings.as_ref().filter(|crossings| crossings.count > 0) {
        let [x, y, z] = crossings.places.first().copied().unwrap_or_default();
        let text = format!(
            "{} facets of the result cross others, the first at {x:.4} {y:.4} {z:.4}: parts are nearer to each other than an \
             edge there, or cross in the input; more points keep them apart",
            crossings.count
        );
        let places = crossings.places.clone();
        all.push(Warning { places, ..Warning::new("crossing_facets", Some(crossings.count), text) });
    }
    let folded =
        "edges of the result are folded over 150°, and none of the input is there; more points give its creases room";
    counted(all, "folded_edges", report.result.folded_edges.unwrap_or(0), folded);
    let refine = &report.refine;
    let why = match refine.ended {
        Some(RefineEnd::Budget) => "all points are used; a larger `max_points` brings the result nearer",
        Some(RefineEnd::NoProgress) => {
            "more points did not bring the result nearer; check the input for folds and for sheets that touch; a smaller \
             `crease_angle` keeps more edges"
        }
        Some(RefineEnd::Reached) | None => return,
    };
    let (missed, far) = (refine.out_of_tolerance, refine.deviation_percent.unwrap_or(0.0));
    let text = format!(
        "the bound on the deviation is missed: {missed} samples are farther than asked, up to {far:.4} % of the diagonal; {why}"
    );
    all.push(Warning::new("deviation_missed", Some(missed), text));
}
