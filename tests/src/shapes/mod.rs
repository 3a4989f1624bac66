//! Shapes whose exact properties are known in closed form or by quadrature.

pub mod boxes;
pub mod cut;
pub mod round;
pub mod torus;

/// Returns the integral of `f` over `[a, b]` by the midpoint rule with `n` points (exact to
/// round-off for smooth periodic functions).
pub fn integrate(a: f64, b: f64, n: usize, f: impl Fn(f64) -> f64) -> f64 {
    let step = (b - a) / n as f64;
    (0..n).map(|i| f(a + (i as f64 + 0.5) * step)).sum::<f64>() * step
}
