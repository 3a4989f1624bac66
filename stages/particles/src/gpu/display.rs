//! A Vulkan layer of Mesa (device_select) asks the display which adapter drives it, and its Wayland library complains on stderr where
//! there is none (`error: XDG_RUNTIME_DIR is invalid or not set`), as on every server. Nothing here needs a display, or an
//! order of adapters that comes from one.

/// Where no Wayland display can be, starts this program anew without that layer, in the same process and with the same arguments: its
/// own switch is a variable of the environment, which a running process may not set for itself.
///
/// Nothing happens where the user steers the layer (`MESA_VK_DEVICE_SELECT`, `NODEVICE_SELECT`), or where the program cannot be
/// started anew: the complaint does no harm.
pub fn leave_alone() {
    #[cfg(target_os = "linux")]
    {
        use std::os::unix::process::CommandExt;
        let set = |name: &str| std::env::var_os(name).is_some();
        let reachable =
            std::env::var_os("XDG_RUNTIME_DIR").is_some_and(|folder| std::path::Path::new(&folder).is_absolute());
        if reachable || set(SWITCH) || set("MESA_VK_DEVICE_SELECT") {
            return;
        }
        if let Ok(program) = std::env::current_exe() {
            let mut arguments = std::env::args_os();
            let name = arguments.next().unwrap_or_else(|| program.clone().into_os_string());
            // Only comes back when it fails.
            let _ = std::process::Command::new(program).arg0(name).args(arguments).env(SWITCH, "1").exec();
        }
    }
}

/// Switches the layer off; it says so in its own description (`disable_environment`).
#[cfg(target_os = "linux")]
const SWITCH: &str = "NODEVICE_SELECT";
