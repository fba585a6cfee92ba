//! What a person wants to know at the end of a remesh.
//!
//! Invariant: read from the report's JSON, so that a server's remesh has the same summary as a local one. A figure that
//! is not there, or is no number, is left out. Must not know: how the figures came about.

use std::path::Path;

use serde_json::Value;

use crate::exit::NotWritten;

/// Lost parts that are named, at most; the report has more.
const NAMED_PARTS: usize = 3;

/// Lines about the input, each behind a count of the report.
const INPUT: &[(&str, &str)] = &[
    ("stitched_vertices", "vertices of its boundaries were nearly in the same place as others and moved there"),
    (
        "outlier_vertices",
        "vertices are far from all others: check their coordinates, most points go to the spikes there",
    ),
    ("degenerate_facets", "facets have no area and do not count"),
    ("coincident_facets", "facets lay on others, corner on corner, and were left out"),
    ("reoriented_facets", "facets were oriented unlike their neighbours and turned over"),
];
const VOLUME: &[(&str, &str)] = &[(
    "enclosed_facets",
    "facets lie between others: this is a mesh of a volume, no surface; remesh the boundary of it",
)];
const SURFACE: &[(&str, &str)] = &[
    ("back_to_back_facets", "facets lie on others, back to back, and enclose nothing: remesh one side of them"),
    ("non_manifold_edges", "edges have more than two facets; the result is cut there: to choose where, cut the input"),
];

pub(super) struct Told<'a> {
    pub(super) report: &'a Value,
    pub(super) input: &'a Path,
    pub(super) output: &'a Path,
    pub(super) endpoint: Option<&'a str>,
    /// Whether it was said how far the result may be.
    pub(super) bounded: bool,
    pub(super) total_ms: f64,
}

impl Told<'_> {
    pub(super) fn print(&self) -> Result<(), NotWritten> {
        self.lines().iter().try_for_each(|text| outln!("{text}"))
    }

    fn lines(&self) -> Vec<String> {
        let mut lines = Vec::new();
        self.who(&mut lines);
        self.surfaces(&mut lines);
        self.lost(&mut lines);
        self.steps(&mut lines);
        self.quality(&mut lines);
        self.costs(&mut lines);
        lines
    }

    fn who(&self, lines: &mut Vec<String>) {
        let by = text(self.at("/adapter"), "CPU");
        let at = self.endpoint.map(|url| format!(", at {url}")).unwrap_or_default();
        let (backend, threads) = (text(self.at("/backend"), "?"), self.count("/threads"));
        lines.push(format!("backend     {backend} ({by}), {threads} threads{at}"));
    }

    fn surfaces(&self, lines: &mut Vec<String>) {
        let surface = |at: &str| {
            let [vertices, facets] = ["vertices", "facets"].map(|what| self.count(&format!("{at}/{what}")));
            let euler = self.at(&format!("{at}/euler")).as_i64();
            format!("{vertices} vertices, {facets} facets{}", euler.map(|n| format!(", χ {n}")).unwrap_or_default())
        };
        lines.push(format!("input       {}: {}", self.input.display(), surface("/input")));
        let of_kind = if self.at("/input/kind") == "volume" { VOLUME } else { SURFACE };
        for (what, text) in INPUT.iter().chain(of_kind) {
            let count = self.count(&format!("/input/{what}"));
            lines.extend((count > 0).then(|| format!("            {count} {text}")));
        }
        lines.push(format!("result      {}: {}", self.output.display(), surface("/result")));
        let why = match text(self.at("/vertex_count/reason"), "") {
            "given_seeds" => "seeds are given, and none is left out or added",
            "parts" => "the input has so many parts that they need more",
            "close_sheets" => "sheets or parts are nearer to each other than an edge is long",
            "small_parts" => "parts of the input are too small for a facet and were left out; more --points keep them",
            "no_thickness" => "parts of the input have no thickness",
            _ => "",
        };
        if !why.is_empty() {
            lines.push(format!("            {} vertices were asked for: {why}", self.count("/vertex_count/asked")));
        }
        self.removed(lines);
        let dropped_curves = self.count("/features/dropped_curves");
        if dropped_curves > 0 && self.count("/features/creases") == 0 {
            let what = if self.count("/features/boundaries") == 0 { " and boundaries" } else { "" };
            lines.push(format!(
                "            {dropped_curves} creases{what} were given up: they are too close together for so few points"
            ));
        }
        let [without, further] =
            ["seeds_without_vertex", "extra_vertices"].map(|what| self.count(&format!("/result/repair/{what}")));
        if without + further > 0 {
            lines.push(format!(
                "            {without} points have no vertex, {further} vertices share one: the surface is thin there"
            ));
        }
    }

    /// What the result lacks, or has twice in one place.
    fn removed(&self, lines: &mut Vec<String>) {
        let repair = |what: &str| self.count(&format!("/result/repair/{what}"));
        let [pairs, crowded] = ["closed_facet_pairs", "non_manifold_facets"].map(repair);
        let what = if self.at("/input/kind") == "surface" {
            "the surface is thinner than an edge there; more points keep more"
        } else {
            "the input is no manifold there; cut it where its parts meet, or give more points"
        };
        let pairs = (pairs > 0).then(|| format!("{pairs} pairs of facets lay back to back"));
        let crowded = (crowded > 0).then(|| format!("{crowded} facets were too many at an edge"));
        let removed: Vec<String> = pairs.into_iter().chain(crowded).collect();
        if !removed.is_empty() {
            lines.push(format!("            {} and were removed: {what}", removed.join(", ")));
        }
        let coincident = self.count("/result/coincident_vertices");
        if coincident > 0 {
            lines.push(format!(
                "            {coincident} vertices are in the place of others, where parts touch: join no vertices by their places"
            ));
        }
    }

    /// Parts of the input that the result lacks: how many, and the largest ones.
    fn lost(&self, lines: &mut Vec<String>) {
        let count = self.count("/result/lost/count");
        if count == 0 {
            return;
        }
        let area = self.at("/result/lost/area_percent").as_f64().unwrap_or(0.0);
        lines.push(format!(
            "lost        {count} parts of the input, {area:.2} % of its area, are farther than an edge away:"
        ));
        let parts = self.at("/result/lost/parts").as_array().map(Vec::as_slice).unwrap_or_default();
        for part in parts.iter().take(NAMED_PARTS) {
            let number = |key: &str| part[key].as_f64().unwrap_or(0.0);
            let place: Vec<String> = part["place"]
                .as_array()
                .into_iter()
                .flatten()
                .map(|x| format!("{:.4}", x.as_f64().unwrap_or(0.0)))
                .collect();
            let why = match part["reason"].as_str() {
                Some("component") => {
                    "a component of its own, too small for its share of points; remove it, or give more points"
                }
                Some("non_manifold") => "it hangs on an edge of more than two facets; cut it off, or give more points",
                Some("boundary") => "narrower than an edge, at a boundary; more points keep it, or close the hole",
                _ => "thinner than an edge; more points keep it",
            };
            let (at, area, away) = (place.join(" "), number("area_percent"), number("distance_percent"));
            lines
                .push(format!("            at {at}: {area:.3} % of the area, {away:.2} % of the diagonal away: {why}"));
        }
    }

    fn steps(&self, lines: &mut Vec<String>) {
        if let Some((steps, last)) = self.at("/iterations").as_array().and_then(|all| Some((all.len(), all.last()?))) {
            let ratio = last["energy_ratio"].as_f64().map(|ratio| format!(", E/E_hex before the last {ratio:.5}"));
            lines.push(format!("iterations  {steps}{}", ratio.unwrap_or_default()));
        }
        let edge = |which: &str| self.at(&format!("/density/edge_{which}")).as_f64();
        if let (Some(least), Some(median), Some(largest)) = (edge("least"), edge("median"), edge("largest")) {
            let source = text(self.at("/density/source"), "?");
            lines.push(format!("lengths     {source}: target {least:.4e} to {largest:.4e}, median {median:.4e}"));
        }
        if let Some(noise) = self.at("/density/noise_percent").as_f64().filter(|&share| share > 0.0) {
            lines.push(format!(
                "            {noise:.0} % of the surface had lengths that no triangles can follow: they were evened out \
                 between neighbours; smooth them, or give a lower --gradation"
            ));
        }
        if self.count("/refine/closed_ball_rounds") > 0 {
            lines.push("            shorter where the surface is too thin for others".to_owned());
        }
        let [pairs, again, empty] =
            ["pairs", "relaunched_pairs", "empty_cells"].map(|what| self.count(&format!("/rvd/{what}")));
        lines.push(format!("pairs       {pairs}, launched again {again}, empty cells {empty}"));
    }

    fn quality(&self, lines: &mut Vec<String>) {
        let all = |names: &[&str]| -> Option<Vec<f64>> {
            names.iter().map(|what| self.at(&format!("/result/{what}")).as_f64()).collect()
        };
        if let Some([q_min, q_mean, least, mean]) =
            all(&["q_min", "q_avg", "theta_min_deg", "theta_avg_deg"]).as_deref()
        {
            lines.push(format!(
                "quality     Q min {q_min:.4}, mean {q_mean:.4}; angle min {least:.2}°, mean {mean:.2}°"
            ));
        }
        if let Some([under, valence]) = all(&["under_30_percent", "v567_percent"]).as_deref() {
            lines.push(format!("            under 30° {under:.2} %; valence 5-7 {valence:.2} %"));
        }
        if let Some([hausdorff, rms]) = all(&["hausdorff_percent", "rms_percent"]).as_deref() {
            lines.push(format!("distance    Hausdorff {hausdorff:.4} %, RMS {rms:.4} % of the diagonal"));
        }
        let [rim, edges, vertices] = ["boundary_edges", "non_manifold_edges", "non_manifold_vertices"]
            .map(|what| self.count(&format!("/result/{what}")));
        lines.push(format!(
            "topology    {rim} boundary edges, {edges} non-manifold edges, {vertices} non-manifold vertices"
        ));
        let changes = self.at("/topology_changes").as_array().map(Vec::as_slice).unwrap_or_default();
        if !changes.is_empty() {
            let odd = self.count("/input/non_manifold_edges") + self.count("/input/non_manifold_vertices");
            let why = if odd > 0 { "the input is no manifold, as the result is" } else { "more points keep more" };
            let changes: Vec<&str> = changes.iter().filter_map(Value::as_str).collect();
            lines.push(format!("changed     {}; {why}", changes.join(", ")));
        }
        let (added, missed) = (self.count("/refine/added_seeds"), self.count("/refine/out_of_tolerance"));
        if added > 0 {
            lines.push(format!("added       {added} points, where the result was too far from the input"));
        }
        if self.bounded {
            let deviation = self.at("/refine/deviation_percent").as_f64();
            let deviation = deviation.map(|d| format!("{d:.4} % of the diagonal, ")).unwrap_or_default();
            let far = format!("{deviation}{missed} samples are farther than asked");
            match text(self.at("/refine/ended"), "") {
                "reached" => lines.push(format!("deviation   reached: {deviation}both ways")),
                "budget" => {
                    lines.push(format!("deviation   {far}: all points are used"));
                    lines.push("            a larger --max-points brings the result nearer".to_owned());
                }
                "no_progress" => {
                    lines.push(format!("deviation   {far}: more points did not bring the result nearer"));
                    lines.push(
                        "            check the input for folds and for sheets that touch; a smaller --crease-angle keeps more edges"
                            .to_owned(),
                    );
                }
                _ if missed > 0 => lines.push(format!("deviation   {missed} places are farther than asked")),
                _ => {}
            }
        }
    }

    fn costs(&self, lines: &mut Vec<String>) {
        if let Some(bytes) = self.at("/memory/host_peak_bytes").as_u64() {
            let device = self.count("/memory/device_bytes") >> 20;
            lines.push(format!("memory      {} MiB, {device} MiB on the device", bytes >> 20));
        }
        let total = self.total_ms;
        let there = self.at("/timings_ms/total").as_f64().filter(|_| self.endpoint.is_some());
        let of_it = there.map(|there| format!(", {there:.0} ms of it at work on the server")).unwrap_or_default();
        lines.push(format!("time        {total:.0} ms{of_it}"));
    }

    fn at(&self, pointer: &str) -> &Value {
        self.report.pointer(pointer).unwrap_or(&Value::Null)
    }

    /// A count; 0 where an older server says nothing of it.
    fn count(&self, pointer: &str) -> u64 {
        self.at(pointer).as_u64().unwrap_or(0)
    }
}

fn text<'a>(value: &'a Value, none: &'a str) -> &'a str {
    value.as_str().unwrap_or(none)
}
