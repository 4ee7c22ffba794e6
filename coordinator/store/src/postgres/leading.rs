//! Who leads: one of the coordinators on a database, for as long as it keeps saying so.
//!
//! The row of `leader` holds who leads, under which epoch, and until when by the database's clock. The leader
//! moves that time on every second. When it has passed, the first coordinator that finds so takes over: under
//! the next epoch, and closing the leadership before in `fence`, which makes it wait for transactions that
//! are being committed under it (see `writing.rs`). Take-overs and resignations wake the others.
//!
//! The time decides how soon somebody else takes over. That nothing is changed by two does not depend on it.

use std::sync::Arc;
use std::time::Duration;

use tokio::sync::Notify;
use tokio::time::{Instant, sleep, timeout};
use tokio_postgres::types::ToSql;
use tokio_postgres::{Client, IsolationLevel};

use super::link::{AGAIN, Server};
use super::standing::{Leader, Role, Standing};
use crate::error::StoreError;

/// How long a leadership lives without being renewed.
const LIFE: Duration = Duration::from_secs(3);
/// How often it is renewed.
const RENEW: Duration = Duration::from_secs(1);
/// The longest wait between two looks at who leads.
const LOOK: Duration = Duration::from_millis(500);
/// How long a statement about leadership may take. A take-over may wait for a transaction of the leader
/// before.
const ANSWER: Duration = Duration::from_secs(4);

const LISTEN: &str = "LISTEN sightline_leader";
const NOTIFY: &str = "NOTIFY sightline_leader";
const TAKE: &str = "UPDATE leader SET holder = $1, address = $2, epoch = epoch + 1, \
    until = clock_timestamp() + $3 * interval '1 s' WHERE until < clock_timestamp() RETURNING epoch";
const FENCE: &str = "WITH closing AS (UPDATE fence SET closed = true WHERE NOT closed) \
    INSERT INTO fence VALUES ($1, 0, false)";
/// What became of commits is asked for soon after them, so that old rows are of no use.
const TIDY: &str = "DELETE FROM fence WHERE epoch < $1::bigint - 100";
const RENEWAL: &str =
    "UPDATE leader SET until = clock_timestamp() + $2 * interval '1 s' WHERE epoch = $1";
const RESIGN: &str =
    "UPDATE leader SET until = clock_timestamp() - interval '1 ms' WHERE epoch = $1";
const WHO: &str = "SELECT epoch, holder, address FROM leader WHERE until > clock_timestamp()";

/// A coordinator that would lead.
pub(super) struct Candidate {
    pub(super) server: Server,
    pub(super) standing: Standing,
    /// Its name, for people.
    pub(super) holder: String,
    /// Where it is called.
    pub(super) address: String,
    /// It is told to resign.
    pub(super) resigns: Arc<Notify>,
}

/// Why nothing is asked of a connection any more.
enum Stop {
    /// The connection is of no use; another one may be.
    Lost(StoreError),
    /// There is nothing more to do.
    Ended,
}

impl Candidate {
    /// Stands by and leads until it resigns or another coordinator has taken over.
    pub(super) async fn run(self) {
        let notified = Arc::new(Notify::new());
        let [first, longest] = AGAIN;
        let mut wait = first;
        // When the leadership ends by the clock of this machine, if it is not renewed.
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
            tracing::warn!("{why}; tried again");
            if let Some((epoch, deadline)) = until
                && Instant::now() + wait >= deadline
            {
                let what = why.to_string();
                return self
                    .standing
                    .set(Role::Ended(StoreError::NotRenewed { epoch, what }));
            }
            tokio::select! {
                () = sleep(wait) => {}
                // There is no connection to say so; the leadership ends by itself.
                () = self.resigns.notified() => return,
            }
            wait = longest.min(wait * 2);
        }
    }

    /// Stands by, then leads, over one connection.
    async fn follow(
        &self,
        mut client: Client,
        notified: &Notify,
        until: &mut Option<(i64, Instant)>,
    ) -> Result<(), Stop> {
        loop {
            let wait = match *until {
                None => match self.look(&mut client).await? {
                    // At once, for taking over may have waited.
                    Some((epoch, deadline)) => {
                        *until = Some((epoch, deadline));
                        continue;
                    }
                    None => LOOK,
                },
                Some((epoch, deadline)) => {
                    let next = self.renew(&client, epoch, deadline).await?;
                    // Who leads is known only now: taking over may have taken longer than the leadership
                    // lives.
                    self.standing.set(Role::Leads(epoch));
                    *until = Some((epoch, next));
                    RENEW
                }
            };
            tokio::select! {
                () = sleep(wait) => {}
                () = notified.notified() => {}
                () = self.resigns.notified() => {
                    if let Some((epoch, _)) = *until {
                        self.standing.set(Role::Ended(StoreError::Fenced { epoch }));
                        self.say(&client, RESIGN, epoch).await?;
                    }
                    return Ok(());
                }
            }
        }
    }

    /// Takes over if nobody leads, and gives the epoch and its end; else notes who leads.
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
        self.standing.set(Role::StandsBy(
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

    /// Renews the leadership; gives its new end.
    async fn renew(&self, client: &Client, epoch: i64, deadline: Instant) -> Result<Instant, Stop> {
        let begun = Instant::now();
        let life = LIFE.as_secs_f64();
        let values: [&(dyn ToSql + Sync); 2] = [&epoch, &life];
        let renewed = client.execute(RENEWAL, &values);
        match tokio::time::timeout_at(deadline.max(begun + RENEW), renewed).await {
            Ok(Ok(1..)) => Ok(begun + LIFE),
            Ok(Ok(0)) => {
                self.standing.deposed(epoch);
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

/// An answer within the time that answers have; `None` is the error of a time that is over.
async fn in_time<T>(
    answer: impl Future<Output = Result<T, tokio_postgres::Error>>,
) -> Result<T, Option<tokio_postgres::Error>> {
    match timeout(ANSWER, answer).await {
        Ok(answered) => answered.map_err(Some),
        Err(_) => Err(None),
    }
}
