//! Whether a specification makes sense.
//!
//! Purpose: [`JobSpec::check`] makes a [`ValidSpec`]; a record that is read is checked by the same function.
//! Invariant: what is valid can be encoded and read again with the same bits, and is at most [`MAX_SPEC_BYTES`] long. Counts
//! that a server bounds, and what arrays hold, are looked at where they are known.
//! Must not know: limits of a server, stores.

use std::collections::BTreeSet;
use std::ops::Deref;

use serde::{Deserialize, Serialize};

use super::spec::*;
use geometry::mesh::attributes::MAX_NAME_BYTES;

/// The longest specification, encoded, bytes.
const MAX_SPEC_BYTES: usize = 64 << 10;
/// Labels of a job.
const MAX_LABELS: usize = 64;
/// Attributes of a surface.
const MAX_ATTRIBUTES: usize = 256;
/// Indices have 31 bits.
const MAX_COUNT: u64 = i32::MAX as u64 - 8;
/// Ten years: so that no time overflows.
const MAX_DEADLINE_MS: u64 = 10 * 366 * 24 * 3_600_000;

/// Why a specification was refused. Every variant has the field, as `work.remesh.density.gradation`.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum SpecError {
    /// It must be given.
    #[error("{field} is missing; {hint}")]
    Missing {
        /// Where.
        field: String,
        /// What to give.
        hint: &'static str,
    },
    /// It must not be given beside something else.
    #[error("{field} {problem}")]
    Conflict {
        /// Where.
        field: String,
        /// With what, and what to do.
        problem: &'static str,
    },
    /// A number is not in its range.
    #[error("{field} is {value}; it must be {range}")]
    Range {
        /// Where.
        field: String,
        /// As given.
        value: String,
        /// What it must be.
        range: String,
    },
    /// A text has other characters than it may, or is too long.
    #[error("{field} is {value:?}; it must be {rule}")]
    Text {
        /// Where.
        field: String,
        /// The beginning of what was given.
        value: String,
        /// What it must be.
        rule: &'static str,
    },
    /// The whole is too long.
    #[error("the specification is {bytes} bytes long; at most {most} are taken: put long lists into blobs")]
    TooLong {
        /// How long.
        bytes: usize,
        /// How long it may be.
        most: usize,
    },
}

impl SpecError {
    /// Which field is wrong; empty for the whole.
    pub fn field(&self) -> &str {
        match self {
            Self::Missing { field, .. }
            | Self::Conflict { field, .. }
            | Self::Range { field, .. }
            | Self::Text { field, .. } => field,
            Self::TooLong { .. } => "",
        }
    }
}

/// A specification that makes sense.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(try_from = "JobSpec", into = "JobSpec")]
pub struct ValidSpec(JobSpec);

impl Deref for ValidSpec {
    type Target = JobSpec;

    fn deref(&self) -> &JobSpec {
        &self.0
    }
}

impl From<ValidSpec> for JobSpec {
    fn from(valid: ValidSpec) -> Self {
        valid.0
    }
}

impl TryFrom<JobSpec> for ValidSpec {
    type Error = SpecError;

    fn try_from(spec: JobSpec) -> Result<Self, SpecError> {
        spec.check()
    }
}

type Checked = Result<(), SpecError>;

fn missing(field: &str, hint: &'static str) -> SpecError {
    SpecError::Missing { field: field.to_owned(), hint }
}

fn conflict(field: &str, problem: &'static str) -> SpecError {
    SpecError::Conflict { field: field.to_owned(), problem }
}

fn whole(field: &str, value: u64, least: u64, most: u64) -> Checked {
    match (least..=most).contains(&value) {
        true => Ok(()),
        false => Err(SpecError::Range {
            field: field.to_owned(),
            value: value.to_string(),
            range: format!("from {least} to {most}"),
        }),
    }
}

fn number(field: &str, value: Option<f64>, is_good: impl Fn(f64) -> bool, range: &str) -> Checked {
    match value {
        Some(value) if !value.is_finite() || !is_good(value) => {
            Err(SpecError::Range { field: field.to_owned(), value: value.to_string(), range: range.to_owned() })
        }
        _ => Ok(()),
    }
}

fn text(field: &str, value: &str, most: usize, is_good: impl Fn(char) -> bool, rule: &'static str) -> Checked {
    match value.len() <= most && value.chars().all(is_good) {
        true => Ok(()),
        false => {
            Err(SpecError::Text { field: field.to_owned(), value: value.chars().take(most.min(80)).collect(), rule })
        }
    }
}

fn array(field: &str, array: &ArrayRef, forms: &[ArrayForm], count: Option<u64>) -> Checked {
    if !forms.contains(&array.form) {
        let names: Vec<String> = forms.iter().map(|form| format!("{form:?}").to_lowercase()).collect();
        return Err(SpecError::Range {
            field: format!("{field}.form"),
            value: format!("{:?}", array.form).to_lowercase(),
            range: names.join(" or "),
        });
    }
    let field = format!("{field}.count");
    match (array.form, count) {
        (ArrayForm::Text, _) => whole(&field, array.count, 0, 0),
        (_, Some(count)) => whole(&field, array.count, count, count),
        (_, None) => whole(&field, array.count, 1, MAX_COUNT),
    }
}

impl JobSpec {
    /// Checks everything that can be checked without the blobs.
    ///
    /// # Errors
    /// [`SpecError`] for the first field that is wrong.
    pub fn check(self) -> Result<ValidSpec, SpecError> {
        let printable = |c: char| c.is_ascii_graphic();
        text("tenant", &self.tenant, 128, printable, "at most 128 printable ASCII characters without spaces")?;
        text("request_id", &self.request_id, 128, printable, "at most 128 printable ASCII characters without spaces")?;
        self.check_labels()?;
        if let Some(priority) = self.priority.filter(|priority| !(-100..=100).contains(priority)) {
            let range = "from -100 to 100".to_owned();
            return Err(SpecError::Range { field: "priority".to_owned(), value: priority.to_string(), range });
        }
        for (field, ms) in
            [("deadlines.queue_ms", self.deadlines.queue_ms), ("deadlines.run_ms", self.deadlines.run_ms)]
        {
            ms.map_or(Ok(()), |ms| whole(field, ms, 1, MAX_DEADLINE_MS))?;
        }
        self.mesh.check(matches!(self.work, WorkSpec::Remesh(_)))?;
        let vertices = self.mesh.vertices();
        match &self.work {
            WorkSpec::Remesh(work) => work.check(vertices)?,
            WorkSpec::Rvd(work) => work.check(vertices)?,
            WorkSpec::Cvt(work) => work.check(vertices)?,
        }
        let bytes = serde_json::to_vec(&self).map_or(usize::MAX, |encoded| encoded.len());
        if bytes > MAX_SPEC_BYTES {
            return Err(SpecError::TooLong { bytes, most: MAX_SPEC_BYTES });
        }
        Ok(ValidSpec(self))
    }

    fn check_labels(&self) -> Checked {
        whole("labels", self.labels.len() as u64, 0, MAX_LABELS as u64)?;
        for (key, value) in &self.labels {
            let good = |c: char| c.is_ascii_alphanumeric() || "._-/".contains(c);
            let rule = "a key of 1 to 63 ASCII letters, digits, and ._-/";
            text("labels", key, 63, good, rule)?;
            if key.is_empty() {
                return Err(SpecError::Text { field: "labels".to_owned(), value: String::new(), rule });
            }
            let rule = "at most 255 bytes without control characters";
            text(&format!("labels.{key}"), value, 255, |c| !c.is_control(), rule)?;
        }
        Ok(())
    }
}

impl MeshSource {
    /// How many vertices there are, if that is said.
    fn vertices(&self) -> Option<u64> {
        match self {
            Self::File { .. } => None,
            Self::Arrays { positions, .. } => Some(positions.count),
        }
    }

    fn check(&self, carries: bool) -> Checked {
        let (positions, facets, attributes) = match self {
            Self::File { attributes: Some(true), .. } if !carries => {
                return Err(conflict("mesh.file.attributes", "is set, but only a remesh carries attributes"));
            }
            Self::File { .. } => return Ok(()),
            Self::Arrays { positions, facets, attributes } => (positions, facets, attributes),
        };
        array("mesh.arrays.positions", positions, &[ArrayForm::F32, ArrayForm::F64], None)?;
        array("mesh.arrays.facets", facets, &[ArrayForm::U32], None)?;
        if !carries && !attributes.is_empty() {
            return Err(conflict("mesh.arrays.attributes", "are given, but only a remesh carries attributes"));
        }
        whole("mesh.arrays.attributes", attributes.len() as u64, 0, MAX_ATTRIBUTES as u64)?;
        let mut seen = BTreeSet::new();
        for (index, attribute) in attributes.iter().enumerate() {
            let field = format!("mesh.arrays.attributes[{index}]");
            attribute.check(&field, positions.count, facets.count)?;
            if !seen.insert((attribute.kind as u8, &attribute.name)) {
                return Err(conflict(&field, "is there twice; give each once"));
            }
        }
        Ok(())
    }
}

impl AttributeRef {
    fn check(&self, field: &str, vertices: u64, facets: u64) -> Checked {
        let name = format!("{field}.name");
        let is_scalar = self.kind == AttributeKind::Scalar;
        let rule = "1 to 128 ASCII letters, digits, _ and -, a letter or _ first, for scalars and nothing else";
        let wrong = || SpecError::Text { field: name.clone(), value: self.name.chars().take(80).collect(), rule };
        let good = |c: char| c.is_ascii_alphanumeric() || c == '_' || c == '-';
        text(&name, &self.name, MAX_NAME_BYTES, good, rule)?;
        let begins = self.name.chars().next().is_some_and(|c| c.is_ascii_alphabetic() || c == '_');
        if is_scalar != begins || (!is_scalar && !self.name.is_empty()) {
            return Err(wrong());
        }
        let forms: &[ArrayForm] = match self.kind {
            AttributeKind::Colours => &[ArrayForm::F32, ArrayForm::F64, ArrayForm::U8],
            _ => &[ArrayForm::F32, ArrayForm::F64],
        };
        let corners = format!("{field}.corners");
        match (self.kind, &self.corners) {
            (AttributeKind::Colours | AttributeKind::Scalar, Some(_)) => {
                return Err(conflict(&corners, "are for normals and texture coordinates"));
            }
            (AttributeKind::TextureCoordinates, None) => {
                return Err(missing(&corners, "texture coordinates are given by corner"));
            }
            (_, Some(named)) => array(&corners, named, &[ArrayForm::U32], Some(facets))?,
            (_, None) => {}
        }
        let count = self.corners.is_none().then_some(vertices);
        array(&format!("{field}.values"), &self.values, forms, count)
    }
}

impl SeedSource {
    /// `implied` says whether a density gives edge lengths.
    fn check(&self, field: &str, implied: bool) -> Checked {
        match self {
            Self::Sampled { points: Some(points), .. } => {
                whole(&format!("{field}.sampled.points"), *points, 1, MAX_COUNT)
            }
            Self::Sampled { points: None, .. } if implied => Ok(()),
            Self::Sampled { points: None, .. } => {
                Err(missing(&format!("{field}.sampled.points"), "give a number of points, or edge lengths"))
            }
            Self::Given(given) => {
                array(&format!("{field}.given"), given, &[ArrayForm::F32, ArrayForm::F64, ArrayForm::Text], None)
            }
        }
    }

    fn count(&self) -> Option<u64> {
        match self {
            Self::Sampled { points, .. } => *points,
            Self::Given(given) => Some(given.count).filter(|count| *count > 0),
        }
    }
}

impl DensitySpec {
    fn check(&self, field: &str, vertices: Option<u64>, seeds: &SeedSource) -> Checked {
        let at = |name: &str| format!("{field}.{name}");
        number(&at("edge_length"), self.edge_length, |h| h > 0.0, "finite and above 0")?;
        number(&at("adaptivity"), self.adaptivity, |a| (0.0..=1.0).contains(&a), "from 0 to 1")?;
        number(&at("gradation"), self.gradation, |g| g > 0.0, "finite and above 0")?;
        let kind = self.kind();
        for (name, given, reads, forms) in [
            (
                "edge_lengths",
                &self.edge_lengths,
                kind == DensityKind::EdgeLengths,
                &[ArrayForm::F64, ArrayForm::Text][..],
            ),
            ("weights", &self.weights, kind == DensityKind::Weights, &[ArrayForm::F64][..]),
        ] {
            match given {
                Some(given) if reads => array(&at(name), given, forms, vertices)?,
                Some(_) => return Err(conflict(&at(name), "are given, but the density's source does not read them")),
                None if reads => return Err(missing(&at(name), "the density's source reads them")),
                None => {}
            }
        }
        let counted = !matches!(seeds, SeedSource::Sampled { points: None, .. });
        if self.edge_length.is_some() && counted {
            return Err(conflict(&at("edge_length"), "is given beside a number of seeds; give one of the two"));
        }
        if self.edge_length.is_some() && self.edge_lengths.is_some() {
            return Err(conflict(&at("edge_length"), "is given beside edge_lengths; give one of the two"));
        }
        Ok(())
    }

    fn implies_points(&self) -> bool {
        self.edge_length.is_some() || self.edge_lengths.is_some()
    }
}

impl RemeshWork {
    fn check(&self, vertices: Option<u64>) -> Checked {
        self.density.check("work.remesh.density", vertices, &self.seeds)?;
        self.seeds.check("work.remesh.seeds", self.density.implies_points())?;
        let angle = |a: f64| (0.0..=180.0).contains(&a);
        number("work.remesh.crease_angle_deg", self.crease_angle_deg, angle, "from 0 to 180")?;
        if let Some(creases) = &self.creases {
            array("work.remesh.creases", creases, &[ArrayForm::U32, ArrayForm::Text], None)?;
        }
        let Some(refinement) = self.refinement else { return Ok(()) };
        let (name, value) = match refinement.tolerance {
            Tolerance::Length(length) => ("work.remesh.refinement.tolerance.length", length),
            Tolerance::DiagonalPercent(percent) => ("work.remesh.refinement.tolerance.diagonal_percent", percent),
        };
        number(name, Some(value), |value| value > 0.0, "finite and above 0")?;
        if !matches!(self.placement, None | Some(PlacementRule::Fitted)) {
            return Err(conflict("work.remesh.refinement", "is for fitted results; leave out placement"));
        }
        let field = "work.remesh.refinement.max_points";
        match (refinement.max_points, self.seeds.count()) {
            (Some(most), first) => whole(field, most, first.unwrap_or(1), MAX_COUNT),
            (None, None) if matches!(self.seeds, SeedSource::Sampled { .. }) => {
                Err(missing(field, "it must be given where edge lengths say how many points there are"))
            }
            (None, _) => Ok(()),
        }
    }
}

impl RvdWork {
    fn check(&self, vertices: Option<u64>) -> Checked {
        self.seeds.check("work.rvd.seeds", false)?;
        if let Some(weights) = &self.weights {
            array("work.rvd.weights", weights, &[ArrayForm::F64], vertices)?;
        }
        whole("work.rvd.outputs", self.outputs.len() as u64, 0, 3)
    }
}

impl CvtWork {
    fn check(&self, vertices: Option<u64>) -> Checked {
        self.density.check("work.cvt.density", vertices, &self.seeds)?;
        self.seeds.check("work.cvt.seeds", self.density.implies_points())?;
        if let Some(most) = self.max_seeds {
            whole("work.cvt.max_seeds", most, self.seeds.count().unwrap_or(1), MAX_COUNT)?;
        }
        whole("work.cvt.commands", self.commands.len() as u64, 1, 10_000)?;
        for (index, command) in self.commands.iter().enumerate() {
            let field = format!("work.cvt.commands[{index}]");
            match command {
                CvtCommand::Step { iterations, .. } => {
                    whole(&format!("{field}.step.iterations"), (*iterations).into(), 1, u32::MAX.into())?;
                }
                CvtCommand::Edit { edits, seeds } => {
                    whole(&format!("{field}.edit.edits"), edits.len() as u64, 1, 10_000)?;
                    if *seeds == Some(SendSeeds::Each) {
                        return Err(conflict(&format!("{field}.edit.seeds"), "is \"each\"; an edit has \"last\""));
                    }
                    for (number, edit) in edits.iter().enumerate() {
                        let (SeedChange::Move { to, .. } | SeedChange::Add(to)) = edit else { continue };
                        if !to.iter().all(|c| c.is_finite()) {
                            return Err(SpecError::Range {
                                field: format!("{field}.edit.edits[{number}]"),
                                value: format!("{to:?}"),
                                range: "finite".to_owned(),
                            });
                        }
                    }
                }
            }
        }
        Ok(())
    }
}
