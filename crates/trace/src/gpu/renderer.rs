//! The rendering of cubes in batches: the device draws and reduces a batch, and the host reads its lists at
//! once. At the same time the CPU culls and records the next batch and reads the previous batch.
//!
//! The number of triangles in a batch is known only after rendering. The host therefore reads the first part
//! of the list, as long as earlier batches needed, and the rest of a longer list by a separate read.

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
use crate::cube::{CubeImage, SKY, Strata};
use crate::error::TracerError;
use crate::tracer::CubeRenderer;

/// Maximum size of the pixels in a batch, in bytes. A batch has at least one cube.
const PIXEL_BYTES: u64 = 1 << 27;
/// The number of entries of the list that are read for each cube of the first batch.
const FIRST_READ: u32 = 1024;
/// The number of pixels of a row that one invocation of the reduction reads, and the side of its workgroup,
/// as in `reduce.wgsl`.
const SEGMENT: u32 = 16;
const REDUCE_SIDE: u32 = 8;
/// The number of workgroups of the gathering pass. Each iterates over the list in strides.
const GATHER_GROUPS: u32 = 64;

/// (triangle id, strata mask, pixel count), in any order.
type Runs = Vec<(u32, u32, u32)>;

/// Buffers for rendering cubes, used by one call at a time.
#[derive(Default)]
pub(super) struct CubeBuffers {
    tally: Option<DeviceTally>,
    /// The number of entries of a list to read for each cube; 0 before the first batch.
    entries: u32,
    spare: Spare,
}

/// The parts of a cube to read back.
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
    /// The size of the pixels of a cube, and of a row of pixels, in bytes.
    cube_bytes: u64,
    row_bytes: u32,
    bytes: u64,
}

/// A batch of cubes that was submitted to the device.
struct CubeBatch {
    /// The indices of the batch's points.
    cubes: Range<usize>,
    /// The index of the batch's list.
    list: usize,
    layout: Layout,
    read: Reading,
}

/// A renderer of the triangles of one [`Geometry`].
pub(super) struct GpuRenderer<'a> {
    gpu: &'a Gpu,
    kit: &'a Kit,
    /// The buffers of one batch, shared by all renderers of the device.
    buffers: &'a Mutex<CubeBuffers>,
    geometry: Arc<Geometry>,
}

impl<'a> GpuRenderer<'a> {
    /// Creates a renderer of `geometry`.
    ///
    /// # Errors
    /// [`TracerError::Failed`] if the device cannot create the pipelines.
    pub(super) fn new(
        gpu: &'a Gpu,
        buffers: &'a Mutex<CubeBuffers>,
        geometry: Arc<Geometry>,
    ) -> Result<Self, TracerError> {
        Ok(Self {
            gpu,
            kit: gpu.kit()?,
            buffers,
            geometry,
        })
    }

    fn pixels(&self) -> u32 {
        // The number is at most 6 · 4096².
        6 * self.gpu.spec.resolution * self.gpu.spec.resolution
    }

    /// Renders a cube at each point and passes its requested parts to `take`, in the points' order.
    fn render(
        &self,
        points: &[Vec3],
        want: Want,
        take: &mut dyn FnMut(usize, Runs, Option<Vec<u32>>),
    ) -> Result<(), TracerError> {
        self.gpu.check()?;
        for p in points {
            // The comparison also rejects NaN.
            if !p.abs().cmple(Vec3::splat(MOST_DISTANT)).all() {
                return Err(self.gpu.failed(format!("a cube at {p} cannot be rendered")));
            }
        }
        if self.geometry.slots() == 0 {
            let sky = want.pixels.then(|| vec![SKY; self.pixels() as usize]);
            (0..points.len()).for_each(|i| take(i, Runs::new(), sky.clone()));
            return Ok(());
        }
        let mut buffers = lock(self.buffers);
        let result = self.render_all(&mut buffers, points, want, take);
        if result.is_err() {
            // Counts may not be zero, and buffers may still be mapped.
            *buffers = CubeBuffers::default();
        }
        result
    }

    fn render_all(
        &self,
        buffers: &mut CubeBuffers,
        points: &[Vec3],
        want: Want,
        take: &mut dyn FnMut(usize, Runs, Option<Vec<u32>>),
    ) -> Result<(), TracerError> {
        self.make_room(buffers)?;
        let most = match &buffers.tally {
            Some(tally) if want.list => tally.cubes as usize,
            _ => CUBES as usize,
        };
        let most = match want.pixels {
            true => most.min((PIXEL_BYTES / self.pixel_layout().1).max(1) as usize),
            false => most,
        };
        // At least two batches, so that one is always in flight.
        let size = points.len().div_ceil(LISTS).clamp(1, most);
        let mut flights = VecDeque::new();
        for (number, first) in (0..points.len()).step_by(size).enumerate() {
            if flights.len() == LISTS
                && let Some(oldest) = flights.pop_front()
            {
                self.land(buffers, oldest, want, take)?;
            }
            let cubes = first..(first + size).min(points.len());
            flights.push_back(self.launch(buffers, points, cubes, number % LISTS, want)?);
        }
        for flight in flights {
            self.land(buffers, flight, want, take)?;
        }
        Ok(())
    }

    /// Creates buffers for this geometry's slots, if they are missing, and sets the reduction's parameters.
    fn make_room(&self, buffers: &mut CubeBuffers) -> Result<(), TracerError> {
        let b = self.gpu;
        if buffers
            .tally
            .as_ref()
            .is_none_or(|t| t.slots < self.geometry.slots())
        {
            // The old buffers are freed first, because the memory may not suffice for both.
            buffers.tally = None;
            let tally = DeviceTally::new(&b.device, self.kit, self.geometry.slots(), self.pixels());
            buffers.tally = Some(tally.map_err(|reason| b.failed(reason))?);
        }
        let capacity = buffers.tally.as_ref().map_or(0, |t| t.capacity);
        buffers.entries = buffers.entries.max(FIRST_READ);
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

    /// Returns the size of a row of pixels, and of all pixels of a cube, in bytes.
    fn pixel_layout(&self) -> (u32, u64) {
        let n = self.gpu.spec.resolution;
        let row = (3 * n * 4).next_multiple_of(wgpu::COPY_BYTES_PER_ROW_ALIGNMENT);
        (row, u64::from(row) * u64::from(2 * n))
    }

    fn layout(&self, buffers: &CubeBuffers, cubes: usize, want: Want) -> Layout {
        let capacity = buffers.tally.as_ref().map_or(0, |t| t.capacity);
        let entries = if want.list {
            buffers.entries.saturating_mul(cubes as u32).min(capacity)
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
        buffers: &mut CubeBuffers,
        points: &[Vec3],
        cubes: Range<usize>,
        list: usize,
        want: Want,
    ) -> Result<CubeBatch, TracerError> {
        let b = self.gpu;
        let layout = self.layout(buffers, cubes.len(), want);
        let buffer = buffers.spare.buffer(&self.gpu.device, layout.bytes);
        let eyes = &points[cubes.clone()];
        b.queue
            .write_buffer(&self.kit.faces, 0, &face_uniforms(eyes, b.near));
        let into = buffers
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

    /// Draws cube number `cube` of a batch.
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

    /// Adds the last drawn cube to a list.
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

    /// Waits for a batch, and passes the requested parts of its cubes to `take`.
    fn land(
        &self,
        buffers: &mut CubeBuffers,
        flight: CubeBatch,
        want: Want,
        take: &mut dyn FnMut(usize, Runs, Option<Vec<u32>>),
    ) -> Result<(), TracerError> {
        let CubeBatch {
            cubes,
            list,
            layout,
            read,
        } = flight;
        let capacity = buffers.tally.as_ref().map_or(0, |t| t.capacity);
        let spare = &mut buffers.spare;
        let (ends, mut entries, mut pixels) = read.words(self.gpu, spare, |words| {
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
            // The list does not change until this batch has landed.
            let rest = u64::from(count - layout.entries) * ENTRY_BYTES;
            let buffer = buffers.spare.buffer(&self.gpu.device, rest);
            let mut encoder = self
                .gpu
                .device
                .create_command_encoder(&wgpu::CommandEncoderDescriptor::default());
            if let Some(tally) = &buffers.tally {
                let from = &tally.lists[list].entries;
                encoder.copy_buffer_to_buffer(from, layout.list_bytes, &buffer, 0, rest);
            }
            let read = Reading::submit(self.gpu, encoder, buffer)?;
            read.words(self.gpu, &mut buffers.spare, |words| {
                entries.extend_from_slice(&words[..rest as usize / 4]);
                Ok(())
            })?;
            // A quarter more than needed, so that later batches also fit.
            let each = count.div_ceil(cubes.len() as u32);
            buffers.entries = each.saturating_add(each / 4);
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

    /// Returns the triangle ids from the pixels of the atlas, in the order of [`CubeImage`].
    fn faces_of(&self, atlas: &[u32], row_bytes: u32) -> Result<Vec<u32>, TracerError> {
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

    fn stray(&self, slot: u32) -> TracerError {
        self.gpu.failed(format!(
            "it saw triangle {slot} of {} drawn",
            self.geometry.slots()
        ))
    }
}

impl CubeRenderer for GpuRenderer<'_> {
    fn samples(&self, points: &[Vec3]) -> Result<Vec<VisibilitySample>, TracerError> {
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

    fn image(&self, point: Vec3) -> Result<CubeImage, TracerError> {
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
