//! Histories in MySQL and MariaDB. Batches go straight to the server, each in one transaction. During an outage they are
//! spooled to a file instead. A thread waits for the server and writes the spooled batches, in order and each once,
//! before newer ones: recording never waits for a network.

mod connection;
mod session;
mod spool;
#[cfg(test)]
mod tests;
mod write;

use std::{
    sync::Arc,
    thread::{self, JoinHandle},
    time::Duration,
};

use cotorra_graph::{Event, Figure, Stamped, Timestamp};
use parking_lot::{Condvar, Mutex};

use self::{
    connection::{connect, engine_error, prepare},
    session::ServerSession,
    spool::{Next, Record, Spool},
    write::{Receipt, Writer},
};
use crate::{
    error::{Error, Result},
    kind::Kind,
    location::Server,
    page::{Cursor, Page, PageRequest},
    retention::{Retained, Thinned},
    rolled::Reading,
    run::{Entry, Gap, Run, RunId, RunInfo},
    schema::MIGRATIONS,
    sql::{self, Session, integer},
    store::{Selection, Span, Store},
};

/// Timeout of an answer, or of a batch from the spool.
const LONG_PATIENCE: Duration = Duration::from_secs(60);

/// Time between attempts to reach a server after an outage began.
const RETRY: Duration = Duration::from_millis(500);

/// Most idle connections for reading that are kept.
const IDLE_READERS: usize = 4;

type Reader = sql::Reader<ServerSession>;

/// Limits for a server.
#[derive(Debug, Clone, Copy)]
struct Limits {
    /// Timeout of a batch; a server that takes longer counts as gone. Meanwhile the recorder's queue fills.
    patience: Duration,
    /// Capacity of the spool, bytes.
    spool: u64,
}

impl Limits {
    /// Usual limits. In unit tests, the patience suits a busy machine.
    const USUAL: Self =
        Self { patience: Duration::from_secs(if cfg!(test) { 60 } else { 2 }), spool: 256_000_000 };
}

/// A database of a server.
pub(crate) struct Remote {
    shared: Arc<Shared>,
    readers: Mutex<Vec<Reader>>,
    drainer: Option<JoinHandle<()>>,
}

/// State shared by the thread that empties the spool and the callers that write.
struct Shared {
    server: Server,
    patience: Duration,
    state: Mutex<State>,
    /// Notified when an outage begins or ends, and when the history is closed.
    changed: Condvar,
}

struct State {
    /// Writer to the server; `None` during an outage and until the spool is empty.
    direct: Option<Writer>,
    spool: Spool,
    /// Number of the next batch. A batch whose fate is unknown is spooled under its number.
    batch: u64,
    closing: bool,
}

impl Remote {
    /// Opens a history, or creates one, and takes in the spools that other processes left behind in an outage.
    pub fn open(server: &Server) -> Result<Self> {
        Self::within(server, Limits::USUAL)
    }

    fn within(server: &Server, limits: Limits) -> Result<Self> {
        let mut connection = connect(server, LONG_PATIENCE).map_err(|e| engine_error(&server.name, e))?;
        prepare(&mut connection, server, MIGRATIONS)?;
        let spool = Spool::create(&server.spool, &server.name, limits.spool)?;
        let mut writer = Writer::new(ServerSession::new(connection, &server.name));
        for left in Spool::left_behind(&server.spool, &server.name)? {
            take_in(&mut writer, &left)?;
            forget(&writer.session, &left)?;
        }
        let direct = session(server, limits.patience)?;
        let state = State { direct: Some(Writer::new(direct)), spool, batch: 0, closing: false };
        let shared = Arc::new(Shared {
            server: server.clone(),
            patience: limits.patience,
            state: Mutex::new(state),
            changed: Condvar::new(),
        });
        let drainer = thread::Builder::new().name("spool".to_owned()).spawn({
            let shared = shared.clone();
            move || shared.drain()
        });
        let drainer = drainer.map_err(|cause| Error::Thread { cause: Arc::new(cause) })?;
        Ok(Self { shared, readers: Mutex::default(), drainer: Some(drainer) })
    }

    fn read<T>(&self, ask: impl Fn(&Reader) -> Result<T>) -> Result<T> {
        let server = &self.shared.server;
        let taken = self.readers.lock().pop();
        let fresh = || session(server, LONG_PATIENCE).map(Reader::new);
        let (reader, answer) = match taken {
            Some(reader) => match ask(&reader) {
                // The server may have restarted since this connection was made.
                Err(Error::Unreachable { .. }) => {
                    self.readers.lock().clear();
                    let reader = fresh()?;
                    let answer = ask(&reader)?;
                    (reader, answer)
                }
                answer => (reader, answer?),
            },
            None => {
                let reader = fresh()?;
                let answer = ask(&reader)?;
                (reader, answer)
            }
        };
        let mut idle = self.readers.lock();
        if idle.len() < IDLE_READERS {
            idle.push(reader);
        }
        Ok(answer)
    }
}

/// Opens a session; an answer that takes longer than `patience` counts as a lost server.
fn session(server: &Server, patience: Duration) -> Result<ServerSession> {
    let connection = connect(server, patience).map_err(|e| engine_error(&server.name, e))?;
    Ok(ServerSession::new(connection, &server.name))
}

impl Shared {
    /// Begins an outage: from now on, events are spooled.
    fn lose(&self, state: &mut State, error: &Error) {
        tracing::warn!(%error, spool = state.spool.name(), "the history's server does not answer: events are spooled to a file until it is back");
        state.direct = None;
        self.changed.notify_all();
    }

    /// Waits for outages, and writes the spool to the server after each, until the history is closed.
    fn drain(&self) {
        let mut state = self.state.lock();
        loop {
            while state.direct.is_some() && !state.closing {
                self.changed.wait(&mut state);
            }
            if state.direct.is_some() {
                return;
            }
            // When the history is closed, one more attempt.
            let closing = state.closing;
            drop(state);
            let outcome = self.catch_up();
            state = self.state.lock();
            match outcome {
                Ok(()) => tracing::info!("the history's server is back, and has all spooled events"),
                Err(error) if closing => {
                    tracing::warn!(%error, spool = state.spool.name(), "events stay in the spool until the history is opened again");
                    return;
                }
                Err(error) => {
                    tracing::debug!(%error, "the history's server still does not answer");
                    if !state.closing {
                        self.changed.wait_for(&mut state, RETRY);
                    }
                }
            }
        }
    }

    fn catch_up(&self) -> Result<()> {
        let mut writer = Writer::new(session(&self.server, LONG_PATIENCE)?);
        let direct = session(&self.server, self.patience)?;
        let (reader, id) = {
            let state = self.state.lock();
            (state.spool.reader(), state.spool.writer.clone())
        };
        let mut taken = taken(&writer.session, &id)?;
        let mut place = Spool::begin();
        loop {
            let end = {
                let mut state = self.state.lock();
                if place == state.spool.end() {
                    direct.ping()?;
                    state.spool.clear()?;
                    state.direct = Some(Writer::new(direct));
                    self.changed.notify_all();
                    return Ok(());
                }
                state.spool.end()
            };
            match reader.next(place, end)? {
                Next::Record(number, record, behind) => {
                    if taken.is_none_or(|taken| number > taken) {
                        take_record(&mut writer, Receipt { writer: &id, batch: number }, &record)?;
                        taken = Some(number);
                    }
                    place = behind;
                }
                Next::End | Next::Damage(_) => {
                    let cause = std::io::Error::other("the file was changed by another program");
                    let spool = self.state.lock().spool.name().into();
                    return Err(Error::Spool { spool, cause: Arc::new(cause) });
                }
            }
        }
    }
}

/// Returns the number of the last batch of a process that was taken in.
fn taken(session: &ServerSession, writer: &str) -> Result<Option<u64>> {
    let rows = session.rows("SELECT batches FROM spool WHERE writer = ?", &[writer.into()])?;
    let batch = rows.first().map(|row| integer(row, 0).map(i64::cast_unsigned)).transpose();
    batch.map_err(|error| error.of(session.history()))
}

/// Takes in the records that a process left behind.
fn take_in(writer: &mut Writer, spool: &Spool) -> Result<()> {
    let taken = taken(&writer.session, &spool.writer)?;
    let (reader, mut place, mut batches) = (spool.reader(), Spool::begin(), 0);
    loop {
        match reader.next(place, spool.end())? {
            Next::Record(number, record, behind) => {
                if taken.is_none_or(|taken| number > taken) {
                    take_record(writer, Receipt { writer: &spool.writer, batch: number }, &record)?;
                    batches += 1;
                }
                place = behind;
            }
            Next::End => break,
            Next::Damage(detail) => {
                let aside = spool.put_aside()?;
                tracing::error!(file = %aside.display(), detail, "a spool is partly damaged, and was put aside");
                break;
            }
        }
    }
    if batches > 0 {
        tracing::info!(batches, spool = spool.name(), "took in events spooled during the server's outage");
    }
    Ok(())
}

/// Removes a spool of which everything was taken in.
fn forget(session: &ServerSession, spool: &Spool) -> Result<()> {
    if let Err(error) = spool.remove() {
        // Its receipt stays, so that nothing is taken in again.
        tracing::warn!(%error, "cannot remove a spool that is no longer needed");
        return Ok(());
    }
    session.execute("DELETE FROM spool WHERE writer = ?", &[spool.writer.as_str().into()]).map(|_| ())
}

fn take_record(writer: &mut Writer, receipt: Receipt<'_>, record: &Record) -> Result<()> {
    let outcome = match record {
        Record::Batch { events, gaps } => writer.append(events, gaps, receipt),
        Record::End { run, at } => sql::end_run(&writer.session, *run, *at),
    };
    match outcome {
        Err(Error::NoSuchRun(run)) => {
            tracing::error!(%run, "spooled events of this run are dropped: the history no longer has the run");
            Ok(())
        }
        outcome => outcome,
    }
}

impl Drop for Remote {
    fn drop(&mut self) {
        self.shared.state.lock().closing = true;
        self.shared.changed.notify_all();
        if let Some(drainer) = self.drainer.take()
            && drainer.join().is_err()
        {
            tracing::error!("the thread that empties the spool panicked; the spool is kept");
        }
        let mut state = self.shared.state.lock();
        let State { direct, spool, .. } = &mut *state;
        if let Some(writer) = direct
            && let Err(error) = forget(&writer.session, spool)
        {
            tracing::debug!(%error, "a receipt stays in the history");
        }
    }
}

impl Store for Remote {
    fn begin_run(&self, info: &RunInfo) -> Result<RunId> {
        let mut state = self.shared.state.lock();
        let Some(writer) = &mut state.direct else {
            let cause = "it does not answer since an outage, and lacks spooled events".into();
            return Err(Error::Unreachable { history: self.shared.server.name.clone(), cause });
        };
        let begun = sql::begin_run(&writer.session, info);
        if let Err(error @ Error::Unreachable { .. }) = &begun {
            self.shared.lose(&mut state, error);
        }
        begun
    }

    fn end_run(&self, run: RunId, at: Timestamp) -> Result<()> {
        let mut state = self.shared.state.lock();
        if let Some(writer) = &mut state.direct {
            match sql::end_run(&writer.session, run, at) {
                outcome @ (Ok(()) | Err(Error::NoSuchRun(_))) => return outcome,
                Err(error) => self.shared.lose(&mut state, &error),
            }
        }
        let number = state.batch;
        state.spool.push_end(number, run, at)?;
        state.batch += 1;
        Ok(())
    }

    fn run(&self, run: RunId) -> Result<Run> {
        self.read(|reader| reader.run(run))
    }

    fn runs(&self, after: Option<RunId>, limit: usize) -> Result<Vec<Run>> {
        self.read(|reader| reader.runs(after, limit))
    }

    fn append(&self, events: &[Entry], gaps: &[(RunId, Gap)]) -> Result<()> {
        let mut state = self.shared.state.lock();
        let number = state.batch;
        let State { direct, spool, .. } = &mut *state;
        if let Some(writer) = direct {
            match writer.append(events, gaps, Receipt { writer: &spool.writer, batch: number }) {
                Ok(()) => {
                    state.batch += 1;
                    return Ok(());
                }
                // Busy: rolled back, because another process was in the way; the same is tried again soon.
                Err(error @ (Error::NoSuchRun(_) | Error::Busy { .. })) => return Err(error),
                Err(error) => self.shared.lose(&mut state, &error),
            }
        }
        state.spool.push_batch(number, events, gaps)?;
        state.batch += 1;
        Ok(())
    }

    fn events(
        &self,
        run: RunId,
        what: &Selection<'_>,
        span: Span,
        page: PageRequest,
    ) -> Result<Page<Stamped>> {
        self.read(|reader| reader.events(run, what, span, page))
    }

    fn gaps(&self, run: RunId, span: Span, page: PageRequest) -> Result<Page<Gap>> {
        self.read(|reader| reader.gaps(run, span, page))
    }

    fn latest(&self, run: RunId, at: i64) -> Result<Vec<Stamped>> {
        self.read(|reader| reader.latest(run, at))
    }

    fn values(
        &self,
        run: RunId,
        figure: &Figure,
        span: Span,
        each: &mut dyn FnMut(i64, Reading),
    ) -> Result<()> {
        // Gathered first: a question that is repeated must not call `each` twice for a value.
        let values = self.read(|reader| {
            let mut values = Vec::new();
            reader.values(run, figure, span, &mut |t, value| values.push((t, value)))?;
            Ok(values)
        })?;
        values.into_iter().for_each(|(t, value)| each(t, value));
        Ok(())
    }

    fn extent(&self, run: RunId, kind: Kind, span: Span) -> Result<Option<(i64, i64)>> {
        self.read(|reader| reader.extent(run, kind, span))
    }

    fn samples(
        &self,
        run: RunId,
        kind: Kind,
        span: Span,
        after: Cursor,
        limit: usize,
        raw: bool,
    ) -> Result<Vec<(Cursor, Event)>> {
        self.read(|reader| reader.samples(run, kind, span, after, limit, raw))
    }

    fn retained(&self, run: RunId) -> Result<Vec<Retained>> {
        self.read(|reader| reader.retained(run))
    }

    fn thin(&self, run: RunId, kind: Kind, thinned: &[Thinned]) -> Result<()> {
        // Repeating this after a lost answer does no harm.
        self.read(|reader| sql::thin(&reader.session, run, kind, thinned))
    }

    fn note_retained(&self, run: RunId, retained: &Retained) -> Result<()> {
        self.read(|reader| sql::note_retained(&reader.session, run, retained))
    }

    fn remove_run(&self, run: RunId) -> Result<()> {
        self.read(|reader| sql::remove_run(&reader.session, run))
    }
}
