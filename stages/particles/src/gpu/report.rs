//! What the device did and where its time went, for the report.

/// Time of one kernel over a whole run.
#[derive(Clone, Debug, serde::Serialize)]
pub struct KernelTime {
    /// Its name, which is its file's.
    pub kernel: &'static str,
    /// Seconds on the device.
    pub seconds: f64,
    /// Dispatches.
    pub dispatches: u64,
}

/// What the device did, for the report.
#[derive(Clone, Debug, Default, serde::Serialize)]
pub struct DeviceReport {
    /// Name of the adapter.
    pub adapter: String,
    /// Seconds from the start of the upload to the end of the last readback, kernels compiled beforehand.
    pub device_seconds: f64,
    /// Of these: the host's time to make the buffers and hand over fields and particles.
    pub upload_seconds: f64,
    /// Of these: the host's time to encode and hand over passes while the device has nothing to do.
    pub encode_seconds: f64,
    /// Of these: the host's time waiting for passes. What it does for the next pass while the device works is in none of these parts.
    pub wait_seconds: f64,
    /// Of these: to bring the particles back.
    pub readback_seconds: f64,
    /// Seconds that opening the adapter's kernels took.
    pub compile_seconds: f64,
    /// Most bytes of buffers at one time.
    pub peak_device_bytes: u64,
    /// Levels of bins.
    pub levels: usize,
    /// Bins in all levels.
    pub bins: u32,
    /// Time by kernel, the longest first; empty unless asked for.
    pub kernels: Vec<KernelTime>,
}

impl DeviceReport {
    /// This level's report with those of the levels before it.
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
