//! The adapters of this machine: their list, their choice, their numerics profiles and their devices.

use std::sync::OnceLock;

use super::choice::{AdapterChoice, AdapterSummary};
use super::spare::{self, Opened};
use crate::error::TracerError;

/// Returns the adapters of this machine, best first: discrete GPUs, integrated, virtual, others, software.
///
/// Starting the drivers costs tenths of a second, so they are listed once per process.
pub fn adapters() -> Vec<AdapterSummary> {
    LISTED
        .get_or_init(|| summaries(&look_for_adapters()))
        .clone()
}

fn summaries(adapters: &[wgpu::Adapter]) -> Vec<AdapterSummary> {
    adapters
        .iter()
        .map(|adapter| summary(&adapter.get_info()))
        .collect()
}

/// Returns true if this machine may have a hardware GPU, that is, a device file that GPU drivers need.
///
/// This test is far cheaper than starting all drivers. It returns true on systems other than Linux and if
/// `/dev` cannot be read. Many virtual machines have a render node without a GPU. On such machines the
/// drivers are started in vain, but the result is correct.
pub fn device_present() -> bool {
    let named = |entries: std::fs::ReadDir, is: fn(&str) -> bool| {
        entries
            .flatten()
            .any(|e| is(&e.file_name().to_string_lossy()))
    };
    !cfg!(target_os = "linux")
        || std::fs::read_dir("/dev").map_or(true, |entries| named(entries, is_gpu))
        || std::fs::read_dir("/dev/dri").is_ok_and(|entries| named(entries, is_render_node))
}

/// Returns true if `name` in `/dev/dri` is a render node of a kernel driver.
fn is_render_node(name: &str) -> bool {
    name.starts_with("renderD")
}

/// Returns true if `name` in `/dev` belongs to a driver that does not use render nodes.
///
/// These are the drivers of NVIDIA, AMD's compute driver, Windows Subsystem for Linux, ARM, Qualcomm, and
/// Imagination.
fn is_gpu(name: &str) -> bool {
    [
        "nvidia", "nvhost", "nvgpu", "kfd", "dxg", "mali", "kgsl", "pvr",
    ]
    .iter()
    .any(|p| name.starts_with(p))
}

/// The result of [`adapters`].
static LISTED: OnceLock<Vec<AdapterSummary>> = OnceLock::new();

/// Starts the drivers and lists their adapters, best first.
fn look_for_adapters() -> Vec<wgpu::Adapter> {
    let mut descriptor = wgpu::InstanceDescriptor::new_without_display_handle();
    // Validation layers are off, also in debug builds: they cost time and do not change results.
    descriptor.flags = wgpu::InstanceFlags::empty();
    descriptor.backends = wgpu::Backends::PRIMARY;
    let instance = wgpu::Instance::new(descriptor);
    let mut adapters = pollster::block_on(instance.enumerate_adapters(wgpu::Backends::PRIMARY));
    // The sort is stable: adapters of the same kind keep the driver's order.
    adapters.sort_by_key(|adapter| match adapter.get_info().device_type {
        wgpu::DeviceType::DiscreteGpu => 0,
        wgpu::DeviceType::IntegratedGpu => 1,
        wgpu::DeviceType::VirtualGpu => 2,
        wgpu::DeviceType::Other => 3,
        wgpu::DeviceType::Cpu => 4,
    });
    adapters
}

fn summary(info: &wgpu::AdapterInfo) -> AdapterSummary {
    let interface = info.backend.to_str().to_owned();
    let driver = format!("{} {}", info.driver, info.driver_info)
        .trim()
        .to_owned();
    let version = if info.driver_info.is_empty() {
        &info.driver
    } else {
        &info.driver_info
    };
    let profile = format!(
        "gpu/wgpu-30/{}/{}/{}",
        sanitised(&interface),
        sanitised(&info.name),
        sanitised(version)
    );
    let software = info.device_type == wgpu::DeviceType::Cpu;
    AdapterSummary {
        name: info.name.clone(),
        driver,
        interface,
        software,
        profile,
    }
}

/// Converts `text` to printable ASCII without the profile's separator. The result is never empty.
fn sanitised(text: &str) -> String {
    let plain: String = text
        .trim()
        .chars()
        .map(|c| {
            if matches!(c, ' '..='~') && !matches!(c, '/' | '"' | '\\') {
                c
            } else {
                '_'
            }
        })
        .collect();
    // A profile has three such fields, so each is short.
    let plain: String = plain.chars().take(40).collect();
    if plain.is_empty() {
        "unknown".to_owned()
    } else {
        plain
    }
}

/// Returns the numerics profile of the adapter that `choice` selects on this machine.
///
/// # Errors
/// [`TracerError::Unavailable`] if no adapter fits or no fitting adapter can be opened.
pub fn probe(choice: &AdapterChoice) -> Result<String, TracerError> {
    let opened = open(choice)?;
    let profile = opened.summary.profile.clone();
    // The next backend with this choice uses the device.
    spare::give_back(opened);
    Ok(profile)
}

/// Opens the best adapter that `choice` allows and that can be opened, with the largest limits that it
/// supports. The log names adapters that fail.
pub(super) fn open(choice: &AdapterChoice) -> Result<Opened, TracerError> {
    if let Some(opened) = spare::take(choice) {
        return Ok(opened);
    }
    let opened = open_new(choice);
    if opened.is_err() {
        spare::none_opened();
    }
    opened
}

/// Opens an adapter like [`open`], but never uses a spare device.
fn open_new(choice: &AdapterChoice) -> Result<Opened, TracerError> {
    let adapters = look_for_adapters();
    if adapters.is_empty() {
        return Err(TracerError::Unavailable(
            "no Vulkan adapter: install a driver (for example `apt-get install mesa-vulkan-drivers \
                libvulkan1`) \
             or use --backend cpu"
                .to_owned(),
        ));
    }
    let all = summaries(&adapters);
    // The next listing of the adapters does not need to start the drivers again.
    let _ = LISTED.set(all.clone());
    let there = || {
        all.iter()
            .map(|a| a.name.as_str())
            .collect::<Vec<_>>()
            .join("; ")
    };
    let mut refused = TracerError::Unavailable(match choice {
        AdapterChoice::Named(part) => format!(
            "no adapter is named like \"{part}\"; there are: {}",
            there()
        ),
        _ => format!(
            "no hardware adapter, only software ({}); allow software rasterising or use --backend cpu",
            there()
        ),
    });
    let mut fitting = adapters
        .iter()
        .zip(&all)
        .filter(|(_, summary)| choice.fits(summary))
        .peekable();
    let mut has_failed = false;
    while let Some((adapter, summary)) = fitting.next() {
        match open_one(adapter, summary, choice) {
            Ok(opened) => return Ok(opened),
            Err(error) => {
                if let Some((_, next)) = fitting.peek() {
                    tracing::warn!("{error}; {} is tried instead", next.name);
                }
                if !has_failed {
                    refused = error;
                }
                has_failed = true;
            }
        }
    }
    Err(refused)
}

/// Opens an adapter.
fn open_one(
    adapter: &wgpu::Adapter,
    summary: &AdapterSummary,
    choice: &AdapterChoice,
) -> Result<Opened, TracerError> {
    if !adapter
        .get_downlevel_capabilities()
        .flags
        .contains(wgpu::DownlevelFlags::COMPUTE_SHADERS)
    {
        return Err(TracerError::Unavailable(format!(
            "the adapter {} has no compute shaders; update its driver or use --backend cpu",
            summary.name
        )));
    }
    let descriptor = wgpu::DeviceDescriptor {
        label: Some("sightline"),
        required_features: adapter.features() & wgpu::Features::TIMESTAMP_QUERY,
        required_limits: adapter.limits(),
        ..Default::default()
    };
    let (device, queue) = pollster::block_on(adapter.request_device(&descriptor)).map_err(|e| {
        TracerError::Unavailable(format!(
            "the adapter {} cannot be opened: {e}; update its driver or use --backend cpu",
            summary.name
        ))
    })?;
    Ok(Opened {
        device,
        queue,
        summary: summary.clone(),
        choice: choice.clone(),
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn device_files_identify_gpus() {
        assert!(
            ["nvidia0", "nvidiactl", "kfd", "dxg", "mali0", "kgsl-3d0"]
                .iter()
                .all(|n| is_gpu(n))
        );
        assert!(
            !["null", "tty0", "vda", "fb0", "dri", "kvm"]
                .iter()
                .any(|n| is_gpu(n))
        );
        assert!(is_render_node("renderD128") && !is_render_node("card0"));
    }

    #[test]
    fn profiles_are_printable_and_keep_their_fields() {
        assert_eq!(sanitised("AMD/ATI Radeon\u{2122}"), "AMD_ATI Radeon_");
        assert_eq!(sanitised(" \n"), "unknown");
    }
}
