//! The error that stays when a pixel's frames are averaged, as a renderer that accumulates a
//! still picture does.

use crate::tile::TileShape;

/// Mean square of the `errors` (one per pixel, in C order) averaged over `window` frames: the
/// mean over all pixels and over all frames at which the window can start, as the tile wraps in
/// time.
///
/// # Panics
/// If the number of errors is not the shape's, or the window is not 1 to all of its frames.
pub fn accumulated_mean_square(shape: TileShape, errors: &[f32], window: usize) -> f64 {
    let frames = shape.frames();
    let per_frame = shape.width() * shape.height();
    assert_eq!(errors.len(), shape.pixels(), "one error per pixel");
    assert!((1..=frames).contains(&window), "a window of {window} of {frames} frames");
    let mut sums = vec![0.0_f64; per_frame];
    for frame in errors[..window * per_frame].chunks_exact(per_frame) {
        sums.iter_mut().zip(frame).for_each(|(sum, &e)| *sum += f64::from(e));
    }
    // Over the whole period, every start sums the same frames.
    let starts = if window == frames { 1 } else { frames };
    let mut total = 0.0;
    for start in 0..starts {
        total += sums.iter().map(|sum| sum * sum).sum::<f64>();
        let leaving = &errors[start * per_frame..][..per_frame];
        let entering = &errors[(start + window) % frames * per_frame..][..per_frame];
        for ((sum, &old), &new) in sums.iter_mut().zip(leaving).zip(entering) {
            *sum += f64::from(new) - f64::from(old);
        }
    }
    total / (starts * per_frame) as f64 / (window * window) as f64
}

#[cfg(test)]
mod tests {
    use super::super::split_mix::SplitMix;
    use super::*;

    #[test]
    fn windows_slide_over_all_frames_and_wrap() {
        let (width, height, frames) = (3, 2, 5);
        let shape = TileShape::new(width, height, frames, 1, 1).unwrap();
        let mut stream = SplitMix::new(&[1]);
        let errors: Vec<f32> =
            (0..shape.pixels()).map(|_| stream.range(-1.0, 1.0) as f32).collect();
        for window in 1..=frames {
            let mut total = 0.0;
            for start in 0..frames {
                for y in 0..height {
                    for x in 0..width {
                        let sum: f64 = (start..start + window)
                            .map(|t| f64::from(errors[shape.pixel(x, y, t % frames)]))
                            .sum();
                        total += (sum / window as f64).powi(2);
                    }
                }
            }
            let expected = total / shape.pixels() as f64;
            let found = accumulated_mean_square(shape, &errors, window);
            assert!((found - expected).abs() < 1e-14, "{window}: {found} {expected}");
        }
    }
}
