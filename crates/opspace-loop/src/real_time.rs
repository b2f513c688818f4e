//! Real-time scheduling of the thread that controls a real robot, and its memory, locked.
//!
//! [`RealTime::enter`] asks the system for both and keeps what it gets until it is dropped. Enter after all other threads are
//! started: a thread inherits the scheduling of the one that starts it. Simulations never need it.

use std::marker::PhantomData;

/// Priority of the control thread under SCHED_FIFO, of 1 to 99. It is above the threads that handle interrupts, which have 50, so
/// that other devices do not delay a cycle; and below 95, the limit that audio packages grant, and the kernel's own threads at 99.
pub const PRIORITY: u8 = 80;

/// Request for real-time scheduling, from the weakest to the strictest.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord)]
pub enum RealTimeMode {
    /// Nothing is asked for.
    Off,
    /// The loop takes as much as the system allows.
    #[default]
    Auto,
    /// A robot is not driven without it.
    Required,
}

impl RealTimeMode {
    /// Modes, in the order of their names.
    pub const ALL: [Self; 3] = [Self::Auto, Self::Off, Self::Required];

    /// Name in files.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Off => "off",
            Self::Auto => "auto",
            Self::Required => "required",
        }
    }
}

/// Request and priority of a control thread.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub struct RealTimeParameters {
    /// Request.
    pub mode: RealTimeMode,
    /// Priority under SCHED_FIFO, 1 to 99.
    pub priority: u8,
}

impl Default for RealTimeParameters {
    fn default() -> Self {
        Self { mode: RealTimeMode::default(), priority: PRIORITY }
    }
}

impl RealTimeParameters {
    /// Sets the mode.
    #[must_use]
    pub fn with_mode(self, mode: RealTimeMode) -> Self {
        Self { mode, ..self }
    }

    /// Sets the priority, 1 to 99.
    #[must_use]
    pub fn with_priority(self, priority: u8) -> Self {
        Self { priority, ..self }
    }
}

/// Real-time scheduling of this thread, until it is dropped.
#[derive(Debug)]
#[must_use]
pub struct RealTime {
    scheduling: Result<String, String>,
    memory: Result<String, String>,
    mode: RealTimeMode,
    restore: platform::Restore,
    // Scheduling belongs to a thread.
    _thread: PhantomData<*const ()>,
}

impl RealTime {
    /// Asks for SCHED_FIFO for this thread, touches its stack and locks the memory of the process. A thread that has real-time
    /// scheduling already keeps its own. If only a lower priority is allowed, that one is taken.
    pub fn enter(parameters: RealTimeParameters) -> Self {
        let (mode, mut restore) = (parameters.mode, platform::Restore::default());
        if mode == RealTimeMode::Off {
            let off = || Ok("off".to_owned());
            return Self { scheduling: off(), memory: off(), mode, restore, _thread: PhantomData };
        }
        let memory = platform::lock_memory(&mut restore);
        let scheduling = platform::schedule(parameters.priority, &mut restore);
        Self { scheduling, memory, mode, restore, _thread: PhantomData }
    }

    /// True if all that was asked for was granted.
    #[must_use]
    pub fn is_complete(&self) -> bool {
        self.scheduling.is_ok() && self.memory.is_ok()
    }

    /// States what the thread has and what is missing, in one line.
    #[must_use]
    pub fn text(&self) -> String {
        if self.mode == RealTimeMode::Off {
            return "real-time scheduling is off".to_owned();
        }
        let part = |part: &Result<String, String>| part.clone().unwrap_or_else(|missing| missing);
        format!("{}; {}", part(&self.scheduling), part(&self.memory))
    }
}

impl Drop for RealTime {
    fn drop(&mut self) {
        platform::restore(&self.restore);
    }
}

#[cfg(target_os = "linux")]
mod platform {
    use rustix::mm::{MlockAllFlags, mlockall, munlockall};
    use rustix::process::{Resource, getpriority_process, getrlimit, setpriority_process};
    use std::hint::black_box;
    use std::sync::Mutex;
    use thread_priority::unix::{
        NormalThreadSchedulePolicy, RealtimeThreadSchedulePolicy, ThreadSchedulePolicy,
        set_thread_priority_and_policy, thread_native_id, thread_schedule_policy_param,
    };
    use thread_priority::{Error, ThreadPriority, ThreadPriorityValue};

    const FIFO: ThreadSchedulePolicy = ThreadSchedulePolicy::Realtime(RealtimeThreadSchedulePolicy::Fifo);
    const NORMAL: ThreadSchedulePolicy = ThreadSchedulePolicy::Normal(NormalThreadSchedulePolicy::Other);

    /// Bytes of the stack that are touched before the first cycle, so that no page of it is missing later.
    const STACK_BYTES: usize = 256 * 1024;

    /// Value that the crate translates to niceness 0.
    const NICENESS_0: u8 = 48;

    /// Number of threads for which the memory of the process is locked.
    static LOCKS: Mutex<u32> = Mutex::new(0);

    /// State before.
    #[derive(Debug, Default)]
    pub(super) struct Restore {
        is_scheduled: bool,
        niceness: Option<i32>,
        is_locked: bool,
    }

    pub(super) fn schedule(priority: u8, restore: &mut Restore) -> Result<String, String> {
        let (policy, own) =
            thread_schedule_policy_param(thread_native_id()).map_err(|error| words(&error))?;
        if matches!(policy, ThreadSchedulePolicy::Realtime(_)) {
            return Ok(format!("real-time priority {} of the caller", own.sched_priority));
        }
        let niceness = getpriority_process(None).ok();
        // The limit of the process, where it is lower and not zero.
        let limit = getrlimit(Resource::Rtprio).current.unwrap_or(u64::from(priority));
        let lower = u8::try_from(limit).ok().filter(|limit| (1..priority).contains(limit));
        let first = set(priority);
        let (granted, priority) = match (&first, lower) {
            (Err(_), Some(lower)) => (set(lower), lower),
            _ => (first, priority),
        };
        granted.map_err(|error| words(&error))?;
        (restore.is_scheduled, restore.niceness) = (true, niceness);
        Ok(format!("SCHED_FIFO with priority {priority}"))
    }

    fn set(priority: u8) -> Result<(), Error> {
        let value =
            ThreadPriorityValue::try_from(priority).map_err(|_| Error::Priority("a priority is 1 to 99"))?;
        set_thread_priority_and_policy(thread_native_id(), ThreadPriority::Crossplatform(value), FIFO)
    }

    fn words(error: &Error) -> String {
        let cause = match error {
            Error::OS(code) => std::io::Error::from_raw_os_error(*code).to_string(),
            other => other.to_string(),
        };
        format!("no SCHED_FIFO ({cause})")
    }

    /// Locks what is mapped, and what will be unless a limit could make an allocation fail later.
    pub(super) fn lock_memory(restore: &mut Restore) -> Result<String, String> {
        touch_stack();
        let is_unlimited = getrlimit(Resource::Memlock).current.is_none();
        let later = if is_unlimited { MlockAllFlags::FUTURE } else { MlockAllFlags::empty() };
        let mut locks = LOCKS.lock().unwrap_or_else(std::sync::PoisonError::into_inner);
        mlockall(MlockAllFlags::CURRENT | later).map_err(|error| format!("memory not locked ({error})"))?;
        *locks += 1;
        restore.is_locked = true;
        Ok("memory locked".to_owned())
    }

    #[inline(never)]
    fn touch_stack() {
        black_box(&mut [1_u8; STACK_BYTES]);
    }

    pub(super) fn restore(before: &Restore) {
        // A thread may always give up what it has.
        if before.is_scheduled {
            if let Ok(value) = ThreadPriorityValue::try_from(NICENESS_0) {
                let priority = ThreadPriority::Crossplatform(value);
                let _ = set_thread_priority_and_policy(thread_native_id(), priority, NORMAL);
            }
            if let Some(niceness) = before.niceness {
                let _ = setpriority_process(None, niceness);
            }
        }
        if before.is_locked {
            let mut locks = LOCKS.lock().unwrap_or_else(std::sync::PoisonError::into_inner);
            *locks -= 1;
            if *locks == 0 {
                let _ = munlockall();
            }
        }
    }
}

#[cfg(not(target_os = "linux"))]
mod platform {
    #[derive(Debug, Default)]
    pub(super) struct Restore;

    pub(super) fn schedule(_priority: u8, _restore: &mut Restore) -> Result<String, String> {
        Err("no SCHED_FIFO (opspace asks for it on Linux only)".to_owned())
    }

    pub(super) fn lock_memory(_restore: &mut Restore) -> Result<String, String> {
        Err("memory not locked (opspace does it on Linux only)".to_owned())
    }

    pub(super) fn restore(_before: &Restore) {}
}
