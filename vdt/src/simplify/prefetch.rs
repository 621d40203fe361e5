//! Tells the processor that an element of a slice will be read soon.
//!
//! The collapse loop waits for memory most of its time; since a round's batch is a list, what it will touch is known
//! ahead.

/// Has the cache line of `slice[index]` on its way, if there is such an element. Has no effect but on time.
#[inline]
pub(super) fn read<T>(slice: &[T], index: usize) {
    #[cfg(target_arch = "x86_64")]
    if let Some(element) = slice.get(index) {
        use std::arch::x86_64::{_MM_HINT_T0, _mm_prefetch};
        // SAFETY: a prefetch of any address reads and writes nothing, and this one is of an element that exists.
        unsafe { _mm_prefetch::<_MM_HINT_T0>(std::ptr::from_ref(element).cast()) };
    }
    #[cfg(not(target_arch = "x86_64"))]
    let _ = (slice, index);
}

#[cfg(test)]
mod tests {
    use super::read;

    #[test]
    fn any_index_may_be_asked_for() {
        let slice = [1_u32, 2, 3];
        for index in [0, 2, 3, usize::MAX] {
            read(&slice, index);
        }
        read::<u64>(&[], 0);
        assert_eq!(slice, [1, 2, 3]);
    }
}
