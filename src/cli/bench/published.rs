//! Figures of a publication, from a file.
//!
//! Purpose: what `--published` reads, to stand beside what is measured. Invariant: no figure that is not in the
//! file. Must not know: what is measured.

use std::path::Path;

use anyhow::Result;
use serde::{Deserialize, Serialize};

use crate::exit::BadInput;
use crate::files;

/// One row of the table, milliseconds.
#[derive(Clone, Debug, PartialEq, Deserialize, Serialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Row {
    /// The model: a file's name without ending, in any case.
    pub(super) mesh: String,
    pub(super) facets: Option<u64>,
    pub(super) points: Option<u64>,
    pub(super) gpu_ms: Option<f64>,
    pub(super) serial_ms: Option<f64>,
    pub(super) parallel_ms: Option<f64>,
}

impl Row {
    /// Times of the GPU, one core and all cores.
    pub(super) fn times(&self) -> [Option<f64>; 3] {
        [self.gpu_ms, self.serial_ms, self.parallel_ms]
    }
}

#[derive(Clone, Debug, Default, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Published {
    #[serde(default)]
    pub(super) source: String,
    pub(super) rows: Vec<Row>,
}

impl Published {
    pub(super) fn read(path: &Path) -> Result<Self> {
        let bad = |text: String| BadInput(format!("{}: {text}", path.display()));
        let text = files::read_text(path)?;
        let published: Self = serde_json::from_str(&text).map_err(|e| {
            bad(format!(
                "{e}; it should be {{\"source\": \"...\", \"rows\": [{{\"mesh\": \"bunny\", \"gpu_ms\": 1.5, ...}}]}}"
            ))
        })?;
        let times = published.rows.iter().flat_map(Row::times).flatten();
        match times.into_iter().find(|ms| !(ms.is_finite() && *ms > 0.0)) {
            Some(ms) => Err(bad(format!("{ms} is no time; milliseconds are above 0")).into()),
            None => Ok(published),
        }
    }

    pub(super) fn row(&self, mesh: &str) -> Option<&Row> {
        self.rows.iter().find(|row| row.mesh.eq_ignore_ascii_case(mesh))
    }
}
