//! Wake-up of a thread that waits for messages, by a thread that must not lock.

use futures::Stream;
use futures::task::AtomicWaker;
use std::pin::Pin;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::task::{Context, Poll};

/// Wake-up that several threads share.
#[derive(Clone, Debug, Default)]
pub struct Wake(Arc<Inner>);

#[derive(Debug, Default)]
struct Inner {
    waker: AtomicWaker,
    is_set: AtomicBool,
}

impl Wake {
    /// Wakes the thread that waits. Allocates and locks nothing.
    pub fn wake(&self) {
        self.0.is_set.store(true, Ordering::Release);
        self.0.waker.wake();
    }
}

/// Stream of wake-ups; several between two looks are one.
#[derive(Debug)]
pub struct Wakes(pub Wake);

impl Stream for Wakes {
    type Item = ();

    fn poll_next(self: Pin<&mut Self>, context: &mut Context<'_>) -> Poll<Option<()>> {
        let inner = &*self.0.0;
        inner.waker.register(context.waker());
        if inner.is_set.swap(false, Ordering::AcqRel) { Poll::Ready(Some(())) } else { Poll::Pending }
    }
}
