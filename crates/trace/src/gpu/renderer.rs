//! Rendering cubes in batches: the device draws and reduces a batch, whose lists come back in one read.
//! While it does, the CPU culls and records the next batch and reads the previous one.
//!
//! The number of triangles in a batch is known only after it is rendered. So the first part of the list is
//! read back, as long as earlier batches needed, and the rest of a longer list by a read of its own.

use std::collections::VecDeque;
use std::ops::Range;
use std::sync::{Arc, Mutex};

use glam::Vec3;
use sightline_model::VisibilitySample;

use super::device::{Gpu, MOST_DISTANT};
use super::geometry::{Geometry, Visible};
use super::locks::lock;
use super::pipelines::{CUBES, FACE_STRIDE, Kit, face_uniforms};
use super::reading::{Reading, Spare};
use super::tally::{BEFORE_ENDS, DeviceTally, ENTRY_BYTES, LIST_HEAD, LISTS, List};
use crate::backend::CubeRenderer;
use crate::cube::{CubeImage, SKY, Strata};
use crate::error::BackendError;

/// Most bytes of pixels in a batch, but there is room for one cube.
const PIXEL_BYTES: u64 = 1 << 27;
/// Entries of the list that are read back for each cube of the first batch.
const FIRST_READ: u32 = 1024;
/// Pixels of a row that one invocation of the reduction reads, and the side of its workgroup; as in
/// `reduce.wgsl`.
const SEGMENT: u32 = 16;
const REDUCE_SIDE: u32 = 8;
/// Workgroups of the gathering pass; each goes through the list in strides.
const GATHER_GROUPS: u32 = 64;

/// (triangle id, strata mask, pixel count), in any order.
type Runs = Vec<(u32, u32, u32)>;

/// Buffers for rendering cubes; used by one call at a time.
#[derive(Default)]
pub(super) struct Work {
    tally: Option<DeviceTally>,
    /// Entries of a list to read back for each cube; 0 before the first batch.
    entries: u32,
    spare: Spare,
}

/// Which parts of a cube to read back.
#[derive(Clone, Copy)]
struct Want {
    list: bool,
    pixels: bool,
}

/// The parts of a read-back buffer, in bytes: the beginning of the list, then the pixels of each cube.
#[derive(Clone, Copy)]
struct Layout {
    entries: u32,
    list_bytes: u64,
    pixels_at: u64,
    /// Bytes of the pixels of a cube, and of a row of them.
    cube_bytes: u64,
    row_bytes: u32,
    bytes: u64,
}

/// A batch of cubes that was submitted to the device.
struct CubeBatch {
    /// Which of the points.
    cubes: Range<usize>,
    /// Which of the lists.
    list: usize,
    layout: Layout,
    read: Reading,
}

/// Renders the triangles of one [`Geometry`].
pub(super) struct GpuRenderer<'a> {
    gpu: &'a Gpu,
    kit: &'a Kit,
    /// The buffers of one batch, shared by all renderers of the device.
    work: &'a Mutex<Work>,
    geometry: Arc<Geometry>,
}

impl<'a> GpuRenderer<'a> {
    /// A renderer of `geometry`.
    ///
    /// # Errors
    /// [`BackendError::Failed`] when the device cannot make the pipelines.
    pub(super) fn new(
        gpu: &'a Gpu,
        work: &'a Mutex<Work>,
        geometry: Arc<Geometry>,
    ) -> Result<Self, BackendError> {
        Ok(Self {
            gpu,
            kit: gpu.kit()?,
            work,
            geometry,
        })
    }

    fn pixels(&self) -> u32 {
        // At most 6 · 4096².
        6 * self.gpu.spec.resolution * self.gpu.spec.resolution
    }

    /// Renders a cube at each point and passes its wanted parts to `take`, in the points' order.
    fn render(
        &self,
        points: &[Vec3],
        want: Want,
        take: &mut dyn FnMut(usize, Runs, Option<Vec<u32>>),
    ) -> Result<(), BackendError> {
        self.gpu.check()?;
        for p in points {
            // Also refuses NaN.
            if !p.abs().cmple(Vec3::splat(MOST_DISTANT)).all() {
                return Err(self.gpu.failed(format!("a cube at {p} cannot be rendered")));
            }
        }
        if self.geometry.slots() == 0 {
            let sky = want.pixels.then(|| vec![SKY; self.pixels() as usize]);
            (0..points.len()).for_each(|i| take(i, Runs::new(), sky.clone()));
            return Ok(());
        }
        let mut work = lock(self.work);
        let result = self.render_all(&mut work, points, want, take);
        if result.is_err() {
            // Counts may not be zero, and buffers may still be mapped.
            *work = Work::default();
        }
        result
    }

    fn render_all(
        &self,
        work: &mut Work,
        points: &[Vec3],
        want: Want,
        take: &mut dyn FnMut(usize, Runs, Option<Vec<u32>>),
    ) -> Result<(), BackendError> {
        self.make_room(work)?;
        let most = match &work.tally {
            Some(tally) if want.list => tally.cubes as usize,
            _ => CUBES as usize,
        };
        let most = match want.pixels {
            true => most.min((PIXEL_BYTES / self.pixel_layout().1).max(1) as usize),
            false => most,
        };
        // Two batches at least, so that there is always one in flight.
        let size = points.len().div_ceil(LISTS).clamp(1, most);
        let mut flights = VecDeque::new();
        for (number, first) in (0..points.len()).step_by(size).enumerate() {
            if flights.len() == LISTS
                && let Some(oldest) = flights.pop_front()
            {
                self.land(work, oldest, want, take)?;
            }
            let cubes = first..(first + size).min(points.len());
            flights.push_back(self.launch(work, points, cubes, number % LISTS, want)?);
        }
        for flight in flights {
            self.land(work, flight, want, take)?;
        }
        Ok(())
    }

    /// Makes buffers for this geometry's slots, if they are missing, and sets the reduction's parameters.
    fn make_room(&self, work: &mut Work) -> Result<(), BackendError> {
        let b = self.gpu;
        if work
            .tally
            .as_ref()
            .is_none_or(|t| t.slots < self.geometry.slots())
        {
            // The old buffers are freed first, since there may not be room for both.
            work.tally = None;
            let tally = DeviceTally::new(&b.device, self.kit, self.geometry.slots(), self.pixels());
            work.tally = Some(tally.map_err(|reason| b.failed(reason))?);
        }
        let capacity = work.tally.as_ref().map_or(0, |t| t.capacity);
        work.entries = work.entries.max(FIRST_READ);
        let strata = match b.spec.strata {
            Strata::One => 0,
            Strata::Faces => 1,
            Strata::Quadrants => 2,
        };
        b.queue.write_buffer(
            &self.kit.params,
            0,
            bytemuck::bytes_of(&[b.spec.resolution, capacity, strata, 0u32]),
        );
        Ok(())
    }

    /// Bytes of a row of pixels, and of all pixels of a cube.
    fn pixel_layout(&self) -> (u32, u64) {
        let n = self.gpu.spec.resolution;
        let row = (3 * n * 4).next_multiple_of(wgpu::COPY_BYTES_PER_ROW_ALIGNMENT);
        (row, u64::from(row) * u64::from(2 * n))
    }

    fn layout(&self, work: &Work, cubes: usize, want: Want) -> Layout {
        let capacity = work.tally.as_ref().map_or(0, |t| t.capacity);
        let entries = if want.list {
            work.entries.saturating_mul(cubes as u32).min(capacity)
        } else {
            0
        };
        let list_bytes = if want.list {
            LIST_HEAD + u64::from(entries) * ENTRY_BYTES
        } else {
            0
        };
        let (row_bytes, cube_bytes) = self.pixel_layout();
        let pixels_at = list_bytes.next_multiple_of(u64::from(wgpu::COPY_BYTES_PER_ROW_ALIGNMENT));
        let pixels = if want.pixels {
            cube_bytes * cubes as u64
        } else {
            0
        };
        Layout {
            entries,
            list_bytes,
            pixels_at,
            cube_bytes,
            row_bytes,
            bytes: pixels_at + pixels,
        }
    }

    /// Records and submits a batch.
    fn launch(
        &self,
        work: &mut Work,
        points: &[Vec3],
        cubes: Range<usize>,
        list: usize,
        want: Want,
    ) -> Result<CubeBatch, BackendError> {
        let b = self.gpu;
        let layout = self.layout(work, cubes.len(), want);
        let buffer = work.spare.buffer(&self.gpu.device, layout.bytes);
        let eyes = &points[cubes.clone()];
        b.queue
            .write_buffer(&self.kit.faces, 0, &face_uniforms(eyes, b.near));
        let into = work
            .tally
            .as_ref()
            .filter(|_| want.list)
            .map(|tally| &tally.lists[list]);
        let mut encoder = b
            .device
            .create_command_encoder(&wgpu::CommandEncoderDescriptor::default());
        if let Some(into) = into {
            encoder.clear_buffer(&into.entries, 0, Some(LIST_HEAD));
        }
        for (k, eye) in eyes.iter().enumerate() {
            self.record_faces(&mut encoder, k as u32, &self.geometry.visible(*eye));
            if let Some(into) = into {
                self.record_reduction(&mut encoder, into);
            }
            if want.pixels {
                encoder.copy_texture_to_buffer(
                    self.kit.items.as_image_copy(),
                    wgpu::TexelCopyBufferInfo {
                        buffer: &buffer,
                        layout: wgpu::TexelCopyBufferLayout {
                            offset: layout.pixels_at + k as u64 * layout.cube_bytes,
                            bytes_per_row: Some(layout.row_bytes),
                            rows_per_image: None,
                        },
                    },
                    self.kit.items.size(),
                );
            }
        }
        if let Some(into) = into {
            encoder.copy_buffer_to_buffer(&into.entries, 0, &buffer, 0, layout.list_bytes);
        }
        let read = Reading::submit(self.gpu, encoder, buffer)?;
        Ok(CubeBatch {
            cubes,
            list,
            layout,
            read,
        })
    }

    /// Draws the cube number `cube` of a batch.
    fn record_faces(&self, encoder: &mut wgpu::CommandEncoder, cube: u32, visible: &Visible) {
        let kit = self.kit;
        let n = self.gpu.spec.resolution;
        let mut pass = encoder.begin_render_pass(&wgpu::RenderPassDescriptor {
            label: Some("cube"),
            color_attachments: &[Some(wgpu::RenderPassColorAttachment {
                view: &kit.items_view,
                depth_slice: None,
                resolve_target: None,
                ops: wgpu::Operations {
                    load: wgpu::LoadOp::Clear(wgpu::Color::TRANSPARENT),
                    store: wgpu::StoreOp::Store,
                },
            })],
            depth_stencil_attachment: Some(wgpu::RenderPassDepthStencilAttachment {
                view: &kit.depth_view,
                depth_ops: Some(wgpu::Operations {
                    load: wgpu::LoadOp::Clear(0.0),
                    store: wgpu::StoreOp::Discard,
                }),
                stencil_ops: None,
            }),
            timestamp_writes: None,
            occlusion_query_set: None,
            multiview_mask: None,
        });
        pass.set_pipeline(&kit.raster);
        for (face, ranges) in (0u32..).zip(visible) {
            if ranges.is_empty() {
                continue;
            }
            let (x, y) = ((face % 3) * n, (face / 3) * n);
            pass.set_bind_group(
                0,
                &kit.faces_group,
                &[(6 * cube + face) * FACE_STRIDE as u32],
            );
            pass.set_viewport(x as f32, y as f32, n as f32, n as f32, 0.0, 1.0);
            pass.set_scissor_rect(x, y, n, n);
            self.geometry.draw(&mut pass, ranges);
        }
    }

    /// Adds the cube that was drawn last to a list.
    fn record_reduction(&self, encoder: &mut wgpu::CommandEncoder, list: &List) {
        let kit = self.kit;
        let n = self.gpu.spec.resolution;
        let mut pass = encoder.begin_compute_pass(&wgpu::ComputePassDescriptor::default());
        pass.set_bind_group(0, &list.group, &[]);
        pass.set_pipeline(&kit.reduce);
        pass.dispatch_workgroups(
            n.div_ceil(SEGMENT * REDUCE_SIDE),
            (6 * n).div_ceil(REDUCE_SIDE),
            1,
        );
        pass.set_pipeline(&kit.gather);
        pass.dispatch_workgroups(GATHER_GROUPS, 1, 1);
        pass.set_pipeline(&kit.close);
        pass.dispatch_workgroups(1, 1, 1);
    }

    /// Waits for a batch, and passes the wanted parts of its cubes to `take`.
    fn land(
        &self,
        work: &mut Work,
        flight: CubeBatch,
        want: Want,
        take: &mut dyn FnMut(usize, Runs, Option<Vec<u32>>),
    ) -> Result<(), BackendError> {
        let CubeBatch {
            cubes,
            list,
            layout,
            read,
        } = flight;
        let capacity = work.tally.as_ref().map_or(0, |t| t.capacity);
        let (ends, mut entries, mut pixels) = read.words(self.gpu, &mut work.spare, |words| {
            let mut pixels = Vec::new();
            if want.pixels {
                let all = words[layout.pixels_at as usize / 4..]
                    .chunks_exact(layout.cube_bytes as usize / 4);
                for atlas in all.take(cubes.len()) {
                    pixels.push(Some(self.faces_of(atlas, layout.row_bytes)?));
                }
            }
            if !want.list {
                return Ok((vec![0; cubes.len()], Vec::new(), pixels));
            }
            let ends = words[BEFORE_ENDS..][..cubes.len()].to_vec();
            let count = ends.last().copied().unwrap_or(0);
            if count > capacity {
                return Err(self.gpu.failed(format!(
                    "a cube shows {count} triangles, more than the {capacity} the device can list; \
                     lower the resolution or use --backend cpu"
                )));
            }
            let read = 3 * count.min(layout.entries) as usize;
            Ok((
                ends,
                words[(LIST_HEAD / 4) as usize..][..read].to_vec(),
                pixels,
            ))
        })?;
        let count = ends.last().copied().unwrap_or(0);
        if count > layout.entries && want.list {
            // The list stays as it is until this batch has landed.
            let rest = u64::from(count - layout.entries) * ENTRY_BYTES;
            let buffer = work.spare.buffer(&self.gpu.device, rest);
            let mut encoder = self
                .gpu
                .device
                .create_command_encoder(&wgpu::CommandEncoderDescriptor::default());
            if let Some(tally) = &work.tally {
                let from = &tally.lists[list].entries;
                encoder.copy_buffer_to_buffer(from, layout.list_bytes, &buffer, 0, rest);
            }
            let read = Reading::submit(self.gpu, encoder, buffer)?;
            read.words(self.gpu, &mut work.spare, |words| {
                entries.extend_from_slice(&words[..rest as usize / 4]);
                Ok(())
            })?;
            // A quarter more than needed, so that later batches fit, too.
            let each = count.div_ceil(cubes.len() as u32);
            work.entries = each.saturating_add(each / 4);
        }
        let mut start = 0;
        pixels.resize(cubes.len(), None);
        for ((index, end), pixels) in cubes.zip(ends).zip(pixels) {
            let own = entries.get(3 * start as usize..3 * end as usize);
            let own = own.ok_or_else(|| self.gpu.failed("the ends of its cubes do not ascend"))?;
            start = end;
            let mut runs = Runs::with_capacity(own.len() / 3);
            for e in own.chunks_exact(3) {
                let id = self
                    .geometry
                    .ids
                    .get(e[0] as usize)
                    .ok_or_else(|| self.stray(e[0]))?;
                runs.push((*id, e[1], e[2]));
            }
            take(index, runs, pixels);
        }
        Ok(())
    }

    /// Triangle ids from the pixels of the atlas, in the order of [`CubeImage`].
    fn faces_of(&self, atlas: &[u32], row_bytes: u32) -> Result<Vec<u32>, BackendError> {
        let (n, pitch) = (self.gpu.spec.resolution as usize, row_bytes as usize / 4);
        let mut ids = Vec::with_capacity(self.pixels() as usize);
        for row in 0..6 * n {
            let (face, y) = (row / n, row % n);
            let start = ((face / 3) * n + y) * pitch + (face % 3) * n;
            for item in &atlas[start..start + n] {
                ids.push(match item.checked_sub(1) {
                    None => SKY,
                    Some(slot) => *self
                        .geometry
                        .ids
                        .get(slot as usize)
                        .ok_or_else(|| self.stray(slot))?,
                });
            }
        }
        Ok(ids)
    }

    fn stray(&self, slot: u32) -> BackendError {
        self.gpu.failed(format!(
            "it saw triangle {slot} of {} drawn",
            self.geometry.slots()
        ))
    }
}

impl CubeRenderer for GpuRenderer<'_> {
    fn samples(&self, points: &[Vec3]) -> Result<Vec<VisibilitySample>, BackendError> {
        let mut samples = vec![VisibilitySample::default(); points.len()];
        let want = Want {
            list: true,
            pixels: self.gpu.spec.keep_pixels,
        };
        self.render(points, want, &mut |index, runs, pixels| {
            samples[index] = VisibilitySample {
                pixels: pixels.map(Into::into),
                ..VisibilitySample::from_runs(runs)
            };
        })?;
        Ok(samples)
    }

    fn image(&self, point: Vec3) -> Result<CubeImage, BackendError> {
        let mut ids = Vec::new();
        self.render(
            &[point],
            Want {
                list: false,
                pixels: true,
            },
            &mut |_, _, pixels| {
                ids = pixels.unwrap_or_default();
            },
        )?;
        Ok(CubeImage {
            resolution: self.gpu.spec.resolution,
            ids,
        })
    }
}
