-- Jobs, leases, progress and requests.

-- The only clock that decides: milliseconds since 1970.
create function tessera.now_ms() returns bigint language sql volatile
    as $$ select floor(extract(epoch from clock_timestamp()) * 1000)::bigint $$;

-- What a program must know to work with this schema: a release that takes something away raises it to the number of the
-- migration that does. Programs that know fewer migrations then refuse to start; others work side by side.
create table tessera.layout (needs bigint not null);
insert into tessera.layout values (1);

-- The columns beside spec, status and log repeat what queries look for.
create table tessera.jobs (
    id bytea primary key check (octet_length(id) = 16),
    tenant text collate "C" not null,
    request_id text collate "C" not null,
    -- As the record's states are numbered: 0 queued, 1 running, 2 succeeded, 3 failed, 4 cancelled, 5 expired.
    state smallint not null,
    version bigint not null,
    priority smallint not null,
    -- For shares of tenants; not used yet.
    class smallint not null default 0,
    cost bigint not null default 0,
    host_bytes bigint not null,
    device_bytes bigint not null,
    created bigint not null,
    changed bigint not null,
    due bigint,
    labels jsonb not null,
    -- The specification: a layout's number and JSON, as in the journal.
    spec bytea not null,
    -- JSON. While the job runs, its lease says until when it is held.
    status text not null,
    -- State changes, and the progress kept at the last of them, as JSON.
    log text not null
) with (fillfactor = 80, autovacuum_vacuum_scale_factor = 0.05);

create index jobs_line on tessera.jobs (priority desc, id) where state = 0;
create index jobs_state on tessera.jobs (state, id);
create index jobs_tenant on tessera.jobs (tenant, id);
create index jobs_labels on tessera.jobs using gin (labels jsonb_path_ops);
create index jobs_due on tessera.jobs (due, id) where due is not null;
create index jobs_results on tessera.jobs (changed, id) where state = 2;
create index jobs_records on tessera.jobs (changed, id) where state > 2;

create table tessera.requests (
    tenant text collate "C" not null,
    request_id text collate "C" not null,
    job bytea not null,
    primary key (tenant, request_id)
);

-- One row for each running job. Renewals and progress update this table alone, no indexed column, with room in the page.
create table tessera.leases (
    job bytea primary key,
    -- The version that the claim gave.
    version bigint not null,
    -- One for each claim, never used again: names the claim's progress.
    token bigint generated always as identity,
    holder text not null,
    until bigint not null,
    -- How long it was given for at last.
    length bigint not null,
    -- Number of the next event.
    next bigint not null
) with (fillfactor = 50, autovacuum_vacuum_scale_factor = 0.0, autovacuum_vacuum_threshold = 500);

-- Sweeps of all processes say that the database answers: when the last one came, and since when none was missing.
create table tessera.pulse (since bigint not null, at bigint not null);
insert into tessera.pulse values (0, 0);

-- Progress since the state last changed. A change of the state copies what is kept of it into the job's log; rows go with
-- their partition, a day each, by tessera.turn_days.
create table tessera.progress (
    token bigint not null,
    number bigint not null,
    at bigint not null,
    what text not null
) partition by range (at);
create index progress_token on tessera.progress (token, number);
create table tessera.progress_other partition of tessera.progress default;

-- Makes the partitions of today and tomorrow, and drops those of the days before the last two. Its caller need not own them.
create function tessera.turn_days() returns void language plpgsql security definer set search_path = pg_catalog, pg_temp as $$
declare
    day constant bigint := 86400000;
    today constant bigint := tessera.now_ms() / day;
    old record;
begin
    -- Another process is at it.
    if not pg_try_advisory_xact_lock(7310293847561) then
        return;
    end if;
    for d in today .. today + 1 loop
        if to_regclass(format('tessera.progress_%s', d)) is null then
            begin
                execute format('create table tessera.progress_%s partition of tessera.progress for values from (%s) to (%s)',
                    d, d * day, (d + 1) * day);
            exception when check_violation then
                -- Progress of this day came before its partition: it stays where it is.
                null;
            end;
        end if;
    end loop;
    for old in
        select c.relname from pg_inherits i join pg_class c on c.oid = i.inhrelid
        where i.inhparent = 'tessera.progress'::regclass and c.relname ~ '^progress_[0-9]+$'
            and substr(c.relname, 10)::bigint < today - 2
    loop
        execute format('drop table tessera.%I', old.relname);
    end loop;
    delete from tessera.progress_other where at < (today - 2) * day;
end $$;
