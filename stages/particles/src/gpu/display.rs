//! Avoids an error message of Mesa's Vulkan layer device_select. The layer asks the display server
//! which adapter drives the display, and puts that adapter first. On a machine without a display,
//! the Wayland library that the layer uses prints `error: XDG_RUNTIME_DIR is invalid or not set` to
//! stderr. This program sorts the adapters itself and does not need the layer.

/// If `XDG_RUNTIME_DIR` is not an absolute path, restarts this program in the same process, with
/// the same arguments and without the layer device_select. An environment variable disables the
/// layer, but a running process cannot safely set this variable for itself.
///
/// Does nothing if the user controls the layer (`MESA_VK_DEVICE_SELECT`, `NODEVICE_SELECT`) or if
/// the restart fails. The message may then appear, but it is harmless.
pub fn leave_alone() {
    #[cfg(target_os = "linux")]
    {
        use std::os::unix::process::CommandExt;
        let set = |name: &str| std::env::var_os(name).is_some();
        let reachable =
            std::env::var_os("XDG_RUNTIME_DIR").is_some_and(|folder| std::path::Path::new(&folder).is_absolute());
        if reachable || set(DISABLE_LAYER) || set("MESA_VK_DEVICE_SELECT") {
            return;
        }
        if let Ok(program) = std::env::current_exe() {
            let mut arguments = std::env::args_os();
            let name = arguments.next().unwrap_or_else(|| program.clone().into_os_string());
            // `exec` returns only if it fails.
            let _ = std::process::Command::new(program).arg0(name).args(arguments).env(DISABLE_LAYER, "1").exec();
        }
    }
}

/// Environment variable that disables the layer (`disable_environment` in the layer's manifest).
#[cfg(target_os = "linux")]
const DISABLE_LAYER: &str = "NODEVICE_SELECT";
