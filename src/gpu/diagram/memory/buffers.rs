//! A session's buffers.
//!
//! Purpose: what a [`Plan`] says, allocated once, under the names of the shaders' bindings.
//! Invariant: fields have the names that the plan has. Must not know: what is in them.

use wgpu::BufferUsages as Usage;

use crate::buffers::{Allocation, Staging, write};
use crate::diagram::layout::Params;
use crate::diagram::plan::{self, OptimizerPlan, Plan, optimizer_buffers, session_buffers};
use crate::dispatch::{self, Origins};
use crate::{Device, GpuError};

const STORAGE: Usage = Usage::STORAGE.union(Usage::COPY_DST).union(Usage::COPY_SRC);
const ARGUMENTS: Usage = STORAGE.union(Usage::INDIRECT);
const UNIFORM: Usage = Usage::UNIFORM.union(Usage::COPY_DST);
const COPIED: Usage = Usage::COPY_SRC.union(Usage::COPY_DST);

/// Makes the buffers of a table in `plan`, and fields for what is made apart.
macro_rules! buffers {
    (
        $plan:ident { $($(#[$apart_doc:meta])* $apart:ident = $apart_bytes:expr,)* }
        $buffers:ident($c:ident: $counts:ty) { $($(#[$doc:meta])* $name:ident: $usage:ident = $bytes:expr,)* }
        [$($own:ident: $type:ty),*]
    ) => {
        #[derive(Debug)]
        pub(crate) struct $buffers {
            $($(#[$doc])* pub $name: wgpu::Buffer,)*
            $(pub $own: $type,)*
            pub plan: $plan,
            _allocation: Allocation,
        }

        impl $buffers {
            fn make(
                device: &Device,
                plan: $plan,
                mut allocation: Allocation,
                ($($own,)*): ($($type,)*),
            ) -> Result<Self, GpuError> {
                Ok(Self {
                    $($name: allocation.make(device, stringify!($name), plan.$name, $usage)?,)*
                    $($own,)*
                    plan,
                    _allocation: allocation,
                })
            }
        }
    };
}
session_buffers!(buffers windows: Vec<WindowBuffers>, staging: Staging);
optimizer_buffers!(buffers);

/// Buffers of the facets of a window.
#[derive(Debug)]
pub(crate) struct WindowBuffers {
    /// Facet records.
    pub facets: wgpu::Buffer,
    pub candidates: wgpu::Buffer,
}

impl Buffers {
    /// Allocates everything, for windows of these numbers of facets. On an error what was allocated is freed again.
    pub(crate) fn new(device: &Device, plan: Plan, windows: &[u64]) -> Result<Self, GpuError> {
        let mut allocation = Allocation::new(device, plan.total_bytes());
        let mut window = |&facets: &u64| {
            let (records, candidates) = plan::window_bytes(facets);
            Ok(WindowBuffers {
                facets: allocation.make(device, "facets", records, STORAGE)?,
                candidates: allocation.make(device, "candidates", candidates, STORAGE)?,
            })
        };
        let windows = windows.iter().map(&mut window).collect::<Result<_, GpuError>>()?;
        let staging = Staging::new(device, &mut allocation, plan.staging)?;
        let made = Self::make(device, plan, allocation, (windows, staging))?;
        write(device, &made.origins, 0, &dispatch::origins(plan.origins / 4))?;
        Ok(made)
    }

    /// Where the parts of a dispatch begin, and where the stages read it.
    pub(crate) fn origins(&self) -> Origins<'_> {
        Origins { of_parts: &self.origins, to: &self.params, offset: std::mem::offset_of!(Params, part_first) as u64 }
    }
}

impl OptimizerBuffers {
    /// Allocates everything, zeroed.
    pub(crate) fn new(device: &Device, plan: OptimizerPlan) -> Result<Self, GpuError> {
        Self::make(device, plan, Allocation::new(device, plan.total_bytes()), ())
    }
}
