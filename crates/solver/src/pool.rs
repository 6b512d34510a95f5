//! Buffers of numbers that are used again, so that a steady stream of updates allocates nothing.

/// Free buffers by capacity: four classes for each doubling.
#[derive(Debug, Default)]
pub(crate) struct Pool {
    classes: Vec<Vec<Vec<f64>>>,
    /// Numbers that the free buffers hold together.
    free: usize,
    /// Numbers that all free buffers may hold together, beyond [`KEPT`].
    allowed: usize,
}

/// Free buffers are kept up to this many times what is in use ...
const KEPT_SHARE: usize = 1;
/// ... and this many numbers: enough for the top of any tree.
const KEPT: usize = 1 << 17;
/// Numbers in buffers that are made together.
const BATCH: usize = 1 << 13;

impl Pool {
    /// Sets how many numbers the cliques hold that are in use, which bounds the free ones; what is
    /// beyond the bound is freed, large buffers first.
    pub(crate) fn set_in_use(&mut self, numbers: usize) {
        self.allowed = KEPT_SHARE * numbers;
        if self.free <= KEPT + self.allowed {
            return;
        }
        for buffers in self.classes.iter_mut().rev() {
            while self.free > KEPT + self.allowed {
                let Some(buffer) = buffers.pop() else { break };
                self.free -= buffer.capacity();
            }
        }
    }

    /// A buffer of `len` zeros.
    pub(crate) fn take(&mut self, len: usize) -> Vec<f64> {
        let (class, capacity) = class_of(len);
        if self.classes.len() <= class {
            self.classes.resize_with(class + 1, Vec::new);
        }
        let buffers = &mut self.classes[class];
        if buffers.is_empty() {
            // A growing map keeps what it takes: small buffers are made many at a time.
            let count = (BATCH / capacity).max(1);
            buffers.extend((0..count).map(|_| Vec::with_capacity(capacity)));
            self.free += count * capacity;
        }
        let mut buffer = buffers.pop().unwrap_or_default();
        self.free -= capacity;
        buffer.resize(len, 0.0);
        buffer
    }

    /// Takes a buffer back, to use it again or, when there are many, to free it.
    pub(crate) fn give(&mut self, mut buffer: Vec<f64>) {
        let (class, capacity) = class_of(buffer.capacity());
        // One that has grown elsewhere may fit no class.
        let fits = buffer.capacity() == capacity;
        if fits && self.free + capacity <= KEPT + self.allowed {
            buffer.clear();
            self.free += capacity;
            match self.classes.get_mut(class) {
                Some(buffers) => buffers.push(buffer),
                None => {
                    self.classes.resize_with(class + 1, Vec::new);
                    self.classes[class].push(buffer);
                }
            }
        }
    }
}

impl Pool {
    /// Bytes of the free buffers.
    pub(crate) fn memory_bytes(&self) -> usize {
        8 * self.free
    }
}

/// The class of buffers for `len` numbers, and their capacity: `len` rounded up to four, five, six
/// or seven times a power of two.
fn class_of(len: usize) -> (usize, usize) {
    let last = len.max(16) - 1;
    let shift = last.ilog2() - 2;
    let quarter = last >> shift;
    (4 * shift as usize + quarter - 4, (quarter + 1) << shift)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn buffers_fit_and_come_back() {
        let mut before = (0, 0);
        for len in 0..5000 {
            let (class, capacity) = class_of(len);
            assert!(capacity >= len.max(16) && capacity <= len.max(16) * 5 / 4 + 1, "{len}");
            assert!((class, capacity) >= before, "{len}");
            assert_eq!(class_of(capacity), (class, capacity));
            before = (class, capacity);
        }
        let mut pool = Pool::default();
        let mut buffer = pool.take(100);
        buffer.fill(7.0);
        let place = buffer.as_ptr();
        pool.give(buffer);
        let again = pool.take(99);
        assert_eq!(again.as_ptr(), place);
        assert!(again.iter().all(|x| *x == 0.0));
    }

    #[test]
    fn free_buffers_are_bounded_by_what_is_in_use() {
        let mut pool = Pool::default();
        let large = || Vec::with_capacity(class_of(1 << 16).1);
        pool.set_in_use(1 << 20);
        (0..100).for_each(|_| pool.give(large()));
        assert!(pool.free > 1 << 20 && pool.free <= KEPT + (1 << 20), "{}", pool.free);
        pool.set_in_use(1000);
        assert!(pool.free <= KEPT + 1000, "{}", pool.free);
        (0..100).for_each(|_| pool.give(large()));
        assert!(pool.free <= KEPT + 1000, "{}", pool.free);
        let kept: usize = pool.classes.iter().flatten().map(Vec::capacity).sum();
        assert_eq!(pool.free, kept);
    }
}
