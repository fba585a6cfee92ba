//! What a person wants to know at the end of a remesh.
//!
//! Invariant: read from the report's JSON, so that a server's remesh has the same summary as a local one. A figure that
//! is not there, or is no number, is left out. Must not know: how the figures came about.

use std::path::Path;

use serde_json::Value;

use crate::exit::NotWritten;

pub(super) struct Told<'a> {
    pub(super) report: &'a Value,
    pub(super) input: &'a Path,
    pub(super) output: &'a Path,
    pub(super) endpoint: Option<&'a str>,
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
        lines.push(format!("result      {}: {}", self.output.display(), surface("/result")));
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
            let bound = self.at("/features/angle_bound_deg").as_f64();
            let bound = bound.map(|of| format!(" (corners leave {of:.2}°)")).unwrap_or_default();
            lines.push(format!(
                "quality     Q min {q_min:.4}, mean {q_mean:.4}; angle min {least:.2}°{bound}, mean {mean:.2}°"
            ));
        }
        if let Some([under, valence]) = all(&["under_30_percent", "v567_percent"]).as_deref() {
            lines.push(format!("            under 30° {under:.2} %; valence 5-7 {valence:.2} %"));
        }
        let of_metric = ["unit_edges_percent", "edge_least", "edge_largest"].map(|what| format!("metric/{what}"));
        if let Some([unit, least, largest]) = all(&of_metric.each_ref().map(String::as_str)).as_deref() {
            let lengths = format!("from {least:.2} to {largest:.2}");
            lines.push(format!("metric      {unit:.2} % of the edges from 0.71 to 1.41, all {lengths}"));
        }
        if let Some([hausdorff, rms]) = all(&["hausdorff_percent", "rms_percent"]).as_deref() {
            lines.push(format!("distance    Hausdorff {hausdorff:.4} %, RMS {rms:.4} % of the diagonal"));
        }
        let [rim, edges, vertices] = ["boundary_edges", "non_manifold_edges", "non_manifold_vertices"]
            .map(|what| self.count(&format!("/result/{what}")));
        lines.push(format!(
            "topology    {rim} boundary edges, {edges} non-manifold edges, {vertices} non-manifold vertices"
        ));
        let added = self.count("/refine/added_seeds");
        if added > 0 {
            lines.push(format!("added       {added} points, where the result was too far from the input"));
        }
        if text(self.at("/refine/ended"), "") == "reached" {
            let deviation = self.at("/refine/deviation_percent").as_f64();
            let deviation = deviation.map(|d| format!("{d:.4} % of the diagonal, ")).unwrap_or_default();
            lines.push(format!("deviation   reached: {deviation}both ways"));
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
