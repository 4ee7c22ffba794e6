//! The reduction's buffers: a strata mask and a pixel count for each slot, and the lists of visible slots.
//! While the device fills one list with the cubes of a batch, the host reads the other list.
//!
//! Masks and counts are zero between cubes: new buffers are zero, and the reduction resets them.

use super::pipelines::{CUBES, Kit, scoped};

/// The number of words before the ends of the cubes in a list.
pub(super) const BEFORE_ENDS: usize = 4;
/// The number of bytes before a list's entries: [`BEFORE_ENDS`] words, and the end of each cube.
pub(super) const LIST_HEAD: u64 = 4 * (BEFORE_ENDS as u64 + CUBES as u64);
/// The number of lists, and of batches of cubes in flight.
pub(super) const LISTS: usize = 2;
/// Maximum size of a list in bytes. A list always has room for one cube.
const LIST_BYTES: u64 = 1 << 26;
/// Size of an entry in bytes: slot, strata mask, pixel count.
pub(super) const ENTRY_BYTES: u64 = 12;

/// The buffers of the reduction for up to `slots` slots.
pub(super) struct DeviceTally {
    pub(super) slots: u32,
    /// The maximum number of entries of a list.
    pub(super) capacity: u32,
    /// The maximum number of cubes of a batch. A list has room for all triangles that these cubes can show,
    /// or for one cube as far as the device allows.
    pub(super) cubes: u32,
    pub(super) lists: [List; LISTS],
}

/// A list, and the bindings of the reduction into it.
pub(super) struct List {
    pub(super) entries: wgpu::Buffer,
    pub(super) group: wgpu::BindGroup,
}

/// Returns the maximum number of slots of a device: masks and counts need one word of a storage binding per
/// slot.
pub(super) fn most_slots(limits: &wgpu::Limits) -> u32 {
    let bytes = limits
        .max_storage_buffer_binding_size
        .min(limits.max_buffer_size);
    u32::try_from(bytes / 4).unwrap_or(u32::MAX)
}

impl DeviceTally {
    /// Creates buffers for at least `slots` slots and cubes of `pixels` pixels.
    ///
    /// # Errors
    /// The device's message if it has not enough memory.
    pub(super) fn new(
        device: &wgpu::Device,
        kit: &Kit,
        slots: u32,
        pixels: u32,
    ) -> Result<Self, String> {
        let limits = device.limits();
        // The number is rounded up, so that supersets of similar size share one allocation.
        let slots = slots
            .checked_next_power_of_two()
            .unwrap_or(u32::MAX)
            .min(most_slots(&limits))
            .max(1);
        let bytes = limits
            .max_storage_buffer_binding_size
            .min(limits.max_buffer_size);
        // A cube shows at most as many triangles as it has pixels, so a list can overflow only if the
        // device's limits shorten it.
        let room = u32::try_from(bytes.saturating_sub(LIST_HEAD) / ENTRY_BYTES).unwrap_or(u32::MAX);
        let cube = slots.min(pixels);
        let cubes =
            (LIST_BYTES / (u64::from(cube) * ENTRY_BYTES)).clamp(1, u64::from(CUBES)) as u32;
        // The product is at most 4096² · 6 for one cube, and less than 2²³ for several cubes.
        let capacity = (cube * cubes).min(room);
        scoped(device, || {
            let storage = |label, size, more| {
                device.create_buffer(&wgpu::BufferDescriptor {
                    label: Some(label),
                    size,
                    usage: wgpu::BufferUsages::STORAGE | more,
                    mapped_at_creation: false,
                })
            };
            let masks = storage("masks", u64::from(slots) * 4, wgpu::BufferUsages::empty());
            let counts = storage("counts", u64::from(slots) * 4, wgpu::BufferUsages::empty());
            let lists = std::array::from_fn(|_| {
                let bytes = LIST_HEAD + u64::from(capacity) * ENTRY_BYTES;
                let entries = storage(
                    "list",
                    bytes,
                    wgpu::BufferUsages::COPY_SRC | wgpu::BufferUsages::COPY_DST,
                );
                let bind = |binding, resource| wgpu::BindGroupEntry { binding, resource };
                let group = device.create_bind_group(&wgpu::BindGroupDescriptor {
                    label: Some("tally"),
                    layout: &kit.tally_layout,
                    entries: &[
                        bind(0, wgpu::BindingResource::TextureView(&kit.items_view)),
                        bind(1, masks.as_entire_binding()),
                        bind(2, counts.as_entire_binding()),
                        bind(3, entries.as_entire_binding()),
                        bind(4, kit.params.as_entire_binding()),
                    ],
                });
                List { entries, group }
            });
            Ok(Self {
                slots,
                capacity,
                cubes,
                lists,
            })
        })
    }
}
