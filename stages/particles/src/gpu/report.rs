//! Statistics of the device and its times, for the report.

/// Time of one kernel over a whole run.
#[derive(Clone, Debug, serde::Serialize)]
pub struct KernelTime {
    /// Name of the kernel and of its file.
    pub kernel: &'static str,
    /// Seconds on the device.
    pub seconds: f64,
    /// Number of dispatches.
    pub dispatches: u64,
}

/// Statistics of the device, for the report.
#[derive(Clone, Debug, Default, serde::Serialize)]
pub struct DeviceReport {
    /// Name of the adapter.
    pub adapter: String,
    /// Seconds from the start of the upload to the end of the last readback, without compilation.
    pub device_seconds: f64,
    /// Part of it: host time to create buffers and upload fields and particles.
    pub upload_seconds: f64,
    /// Part of it: host time to encode and submit passes while the device is idle.
    pub encode_seconds: f64,
    /// Part of it: host time waiting for passes. Host work on the next pass while the device works
    /// is in none of these parts.
    pub wait_seconds: f64,
    /// Part of it: download of the particles.
    pub readback_seconds: f64,
    /// Seconds to compile the kernels.
    pub compile_seconds: f64,
    /// Maximum bytes of buffers at one time.
    pub peak_device_bytes: u64,
    /// Number of levels of bins.
    pub levels: usize,
    /// Number of bins in all levels.
    pub bins: u32,
    /// Time by kernel, the longest first; empty unless requested.
    pub kernels: Vec<KernelTime>,
}

impl DeviceReport {
    /// The sum of this level's report and that of the earlier levels.
    pub(crate) fn after(mut self, before: Self) -> Self {
        self.device_seconds += before.device_seconds;
        self.upload_seconds += before.upload_seconds;
        self.encode_seconds += before.encode_seconds;
        self.wait_seconds += before.wait_seconds;
        self.readback_seconds += before.readback_seconds;
        self.compile_seconds += before.compile_seconds;
        self.peak_device_bytes = self.peak_device_bytes.max(before.peak_device_bytes);
        for old in before.kernels {
            match self.kernels.iter_mut().find(|k| k.kernel == old.kernel) {
                Some(kernel) => {
                    kernel.seconds += old.seconds;
                    kernel.dispatches += old.dispatches;
                }
                None => self.kernels.push(old),
            }
        }
        self.kernels.sort_by(|a, b| b.seconds.total_cmp(&a.seconds));
        self
    }
}
