//! Statistics of the device, including the times of its kernels.

/// Time of one kernel over a whole run.
#[derive(Clone, Debug, serde::Serialize)]
pub struct KernelTime {
    /// Name of the kernel, which is also the name of its file.
    pub kernel: &'static str,
    /// Device time in seconds.
    pub seconds: f64,
    /// Number of dispatches.
    pub dispatches: u64,
}

/// Statistics of the device, for the report.
#[derive(Clone, Debug, Default, serde::Serialize)]
pub struct DeviceReport {
    /// Name of the adapter.
    pub adapter: String,
    /// Seconds from the start of the upload to the end of the last readback, excluding compilation.
    pub device_seconds: f64,
    /// Part of `device_seconds` during which the host creates buffers and uploads fields and
    /// particles.
    pub upload_seconds: f64,
    /// Part of `device_seconds` during which the host encodes and submits passes while the device
    /// is idle.
    pub encode_seconds: f64,
    /// Part of `device_seconds` during which the host waits for passes. None of the parts includes
    /// the time in which the host prepares the next pass while the device works.
    pub wait_seconds: f64,
    /// Part of `device_seconds` during which the particles are downloaded.
    pub readback_seconds: f64,
    /// Time in seconds to compile the kernels.
    pub compile_seconds: f64,
    /// Maximum total size of all buffers in bytes.
    pub peak_device_bytes: u64,
    /// Number of levels of bins.
    pub levels: usize,
    /// Number of bins in all levels.
    pub bins: u32,
    /// Times of the kernels in descending order; empty unless requested.
    pub kernels: Vec<KernelTime>,
}

impl DeviceReport {
    /// Combines the report of this level with the report of the earlier levels: adds the times and
    /// takes the maximum of the memory sizes.
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
