//! Wide instructions where the processor has them: one portable binary, chosen at run time.
//!
//! The code is the same, only compiled twice; nothing is fused or reordered, so both give the same bits.

/// Calls `work`, compiled for AVX2 and bit counting where the processor has them. Only what is inlined into `work` is.
#[inline]
pub(crate) fn widest<R>(work: impl FnOnce() -> R) -> R {
    #[cfg(target_arch = "x86_64")]
    if is_x86_feature_detected!("avx2") && is_x86_feature_detected!("bmi1") && is_x86_feature_detected!("popcnt") {
        // SAFETY: the processor has been asked for every feature that `with_avx2` is compiled for.
        return unsafe { with_avx2(work) };
    }
    work()
}

#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx2,bmi1,popcnt")]
fn with_avx2<R>(work: impl FnOnce() -> R) -> R {
    work()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn wide_and_narrow_code_give_the_same_bits() {
        let values: Vec<f32> = (0..1000).map(|k| (k as f32 * 0.37).sin() * 1e3).collect();
        let work = || {
            let mut lanes = [0.0_f32; 8];
            for chunk in values.chunks_exact(8) {
                for (lane, value) in lanes.iter_mut().zip(chunk) {
                    *lane += value * value * 0.1 + value;
                }
            }
            lanes.map(f32::to_bits)
        };
        assert_eq!(widest(work), work());
    }
}
