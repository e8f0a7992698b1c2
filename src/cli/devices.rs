//! `augnerf bench --devices`.

use serde_json::json;

use super::answer::Answer;
use super::progress::print;
use crate::base::Result;
use crate::runtime::{ListedDevice, list_devices};

/// Lists the devices that `--device` can name.
pub fn list(answer: Answer) -> Result<()> {
    let devices = list_devices();
    answer.give(&json!({ "devices": devices }), || {
        devices.iter().try_for_each(|device| print(&line(device)))?;
        match (cfg!(feature = "gpu"), devices.len()) {
            (false, _) => print("gpu: this program was built without gpu; build it with --features gpu"),
            (true, 1) => print("gpu: no adapter found; install a driver for Vulkan, Metal or DirectX 12"),
            _ => Ok(()),
        }
    })
}

/// Returns a device in a line.
fn line(device: &ListedDevice) -> String {
    const GIB: f64 = (1u64 << 30) as f64;
    let mut line = format!("{:6} {}", device.device, device.name);
    if !device.driver.is_empty() {
        line += &format!(" ({})", device.driver);
    }
    if let Some(bytes) = device.largest_buffer {
        line += &format!(", buffers to {:.1} GiB", bytes as f64 / GIB);
    }
    if device.has_f16 {
        line += ", matrix units";
    }
    if device.is_software {
        line += ", software: for tests, slower than cpu";
    }
    if !device.lacks.is_empty() {
        line += &format!(", unusable: lacks {}", device.lacks.join(", "));
    }
    line
}
