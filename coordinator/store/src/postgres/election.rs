//! The election of the leading coordinator on a database. A leadership lasts while the leader renews it.
//!
//! The row of the table `leader` contains the leader, its epoch, and the end of its leadership by the
//! database's clock. The leader extends that time every second. After that time, the first coordinator that
//! notices takes over with the next epoch. The take-over closes the previous leadership in the table `fence`,
//! so it waits for transactions that are being committed under that leadership (see `writing.rs`). Take-overs
//! and resignations wake the other coordinators.
//!
//! The time only determines how soon another coordinator takes over. The guarantee that at most one
//! coordinator changes the entries does not depend on it.

use std::sync::Arc;
use std::time::Duration;

use tokio::sync::Notify;
use tokio::time::{Instant, sleep, timeout};
use tokio_postgres::types::ToSql;
use tokio_postgres::{Client, IsolationLevel};

use super::leadership::{Leader, Role, SharedRole};
use super::link::{AGAIN, Server};
use crate::error::StoreError;

/// The time after which a leadership ends unless it is renewed.
const LIFE: Duration = Duration::from_secs(3);
/// The interval between renewals.
const RENEW: Duration = Duration::from_secs(1);
/// The maximum interval between two queries for the leader.
const LOOK: Duration = Duration::from_millis(500);
/// Timeout for a statement about the leadership. A take-over may wait for a transaction of the previous
/// leader.
const ANSWER: Duration = Duration::from_secs(4);

const LISTEN: &str = "LISTEN sightline_leader";
const NOTIFY: &str = "NOTIFY sightline_leader";
const TAKE: &str = "UPDATE leader SET holder = $1, address = $2, epoch = epoch + 1, \
    until = clock_timestamp() + $3 * interval '1 s' WHERE until < clock_timestamp() RETURNING epoch";
const FENCE: &str = "WITH closing AS (UPDATE fence SET closed = true WHERE NOT closed) \
    INSERT INTO fence VALUES ($1, 0, false)";
/// The writer looks up a commit shortly after it, so old rows are not needed.
const TIDY: &str = "DELETE FROM fence WHERE epoch < $1::bigint - 100";
const RENEWAL: &str =
    "UPDATE leader SET until = clock_timestamp() + $2 * interval '1 s' WHERE epoch = $1";
const RESIGN: &str =
    "UPDATE leader SET until = clock_timestamp() - interval '1 ms' WHERE epoch = $1";
const WHO: &str = "SELECT epoch, holder, address FROM leader WHERE until > clock_timestamp()";

/// A coordinator that stands for election.
pub(super) struct Candidate {
    pub(super) server: Server,
    pub(super) role: SharedRole,
    /// The name of the coordinator, for display.
    pub(super) holder: String,
    /// The address at which the coordinator is called.
    pub(super) address: String,
    /// The signal to resign.
    pub(super) resigns: Arc<Notify>,
}

/// The reason why a connection is no longer used.
enum Stop {
    /// The connection is unusable; another connection may work.
    Lost(StoreError),
    /// The candidacy has ended.
    Ended,
}

impl Candidate {
    /// Stands by and leads until the candidate resigns or another coordinator takes over from it.
    pub(super) async fn run(self) {
        let notified = Arc::new(Notify::new());
        let [first, longest] = AGAIN;
        let mut wait = first;
        // The end of the leadership by this machine's clock, unless it is renewed.
        let mut until = None;
        loop {
            let one = async {
                let connected = self.server.connect(Some(Arc::clone(&notified)));
                let limit = until.map_or_else(|| Instant::now() + ANSWER, |(_, deadline)| deadline);
                let connected = tokio::time::timeout_at(limit, connected).await;
                let client = connected
                    .unwrap_or_else(|_| Err(self.silent()))
                    .map_err(Stop::Lost)?;
                client
                    .batch_execute(LISTEN)
                    .await
                    .map_err(|e| self.lost(&e))?;
                wait = first;
                self.follow(client, &notified, &mut until).await
            };
            let why = match one.await {
                Ok(()) | Err(Stop::Ended) => return,
                Err(Stop::Lost(why)) => why,
            };
            tracing::warn!("{why}; the coordinator connects again");
            if let Some((epoch, deadline)) = until
                && Instant::now() + wait >= deadline
            {
                let what = why.to_string();
                return self
                    .role
                    .set(Role::Ended(StoreError::NotRenewed { epoch, what }));
            }
            tokio::select! {
                () = sleep(wait) => {}
                // Without a connection, the resignation cannot be announced; the leadership expires.
                () = self.resigns.notified() => return,
            }
            wait = longest.min(wait * 2);
        }
    }

    /// Stands by and then leads, over one connection.
    async fn follow(
        &self,
        mut client: Client,
        notified: &Notify,
        until: &mut Option<(i64, Instant)>,
    ) -> Result<(), Stop> {
        loop {
            let wait = match *until {
                None => match self.look(&mut client).await? {
                    // Continue at once, because the take-over may have waited.
                    Some((epoch, deadline)) => {
                        *until = Some((epoch, deadline));
                        continue;
                    }
                    None => LOOK,
                },
                Some((epoch, deadline)) => {
                    let next = self.renew(&client, epoch, deadline).await?;
                    // Report the leadership only now: the take-over may have taken longer than a leadership
                    // lasts.
                    self.role.set(Role::Leads(epoch));
                    *until = Some((epoch, next));
                    RENEW
                }
            };
            tokio::select! {
                () = sleep(wait) => {}
                () = notified.notified() => {}
                () = self.resigns.notified() => {
                    if let Some((epoch, _)) = *until {
                        self.role.set(Role::Ended(StoreError::Fenced { epoch }));
                        self.say(&client, RESIGN, epoch).await?;
                    }
                    return Ok(());
                }
            }
        }
    }

    /// Takes over if no coordinator leads, and returns the epoch and the deadline. Otherwise records the
    /// leader.
    async fn look(&self, client: &mut Client) -> Result<Option<(i64, Instant)>, Stop> {
        let begun = Instant::now();
        if let Some(epoch) = in_time(self.take_over(client))
            .await
            .map_err(|e| self.failed(e))?
        {
            return Ok(Some((epoch, begun + LIFE)));
        }
        let row = in_time(client.query_opt(WHO, &[]))
            .await
            .map_err(|e| self.failed(e))?;
        let leader = row.map(|row| -> Result<Leader, tokio_postgres::Error> {
            Ok(Leader {
                epoch: row.try_get(0)?,
                holder: row.try_get(1)?,
                address: row.try_get(2)?,
            })
        });
        self.role.set(Role::StandsBy(
            leader.transpose().map_err(|e| self.lost(&e))?,
        ));
        Ok(None)
    }

    async fn take_over(&self, client: &mut Client) -> Result<Option<i64>, tokio_postgres::Error> {
        let change = client
            .build_transaction()
            .isolation_level(IsolationLevel::ReadCommitted);
        let change = change.start().await?;
        let row = change
            .query_opt(TAKE, &[&self.holder, &self.address, &LIFE.as_secs_f64()])
            .await?;
        let Some(row) = row else {
            change.rollback().await?;
            return Ok(None);
        };
        let epoch: i64 = row.try_get(0)?;
        change.execute(FENCE, &[&epoch]).await?;
        change.execute(TIDY, &[&epoch]).await?;
        change.batch_execute(NOTIFY).await?;
        change.commit().await?;
        Ok(Some(epoch))
    }

    /// Renews the leadership and returns its new deadline.
    async fn renew(&self, client: &Client, epoch: i64, deadline: Instant) -> Result<Instant, Stop> {
        let begun = Instant::now();
        let life = LIFE.as_secs_f64();
        let values: [&(dyn ToSql + Sync); 2] = [&epoch, &life];
        let renewed = client.execute(RENEWAL, &values);
        match tokio::time::timeout_at(deadline.max(begun + RENEW), renewed).await {
            Ok(Ok(1..)) => Ok(begun + LIFE),
            Ok(Ok(0)) => {
                self.role.deposed(epoch);
                Err(Stop::Ended)
            }
            Ok(Err(e)) => Err(self.lost(&e)),
            Err(_) => Err(Stop::Lost(self.silent())),
        }
    }

    async fn say(&self, client: &Client, statement: &str, epoch: i64) -> Result<(), Stop> {
        let said = async {
            client.execute(statement, &[&epoch]).await?;
            client.batch_execute(NOTIFY).await
        };
        in_time(said).await.map_err(|e| self.failed(e))
    }

    fn failed(&self, e: Option<tokio_postgres::Error>) -> Stop {
        e.map_or_else(|| Stop::Lost(self.silent()), |e| self.lost(&e))
    }

    fn lost(&self, e: &tokio_postgres::Error) -> Stop {
        Stop::Lost(self.server.meaning(e))
    }

    fn silent(&self) -> StoreError {
        StoreError::Unreachable {
            server: self.server.address.to_string(),
            what: "no answer".to_owned(),
        }
    }
}

/// Waits for an answer for at most [`ANSWER`]. The error is `None` after a timeout.
async fn in_time<T>(
    answer: impl Future<Output = Result<T, tokio_postgres::Error>>,
) -> Result<T, Option<tokio_postgres::Error>> {
    match timeout(ANSWER, answer).await {
        Ok(answered) => answered.map_err(Some),
        Err(_) => Err(None),
    }
}
