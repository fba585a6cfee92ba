-- Servers, fair shares between tenants, and places that are held for large jobs.

-- Processes that use the database. One that was not seen for a while is away.
create table tessera.nodes (
    -- As in leases: no other process has this name.
    holder text collate "C" primary key,
    -- As in uploads.shown_by.
    process bigint not null,
    -- As operators call it.
    name text collate "C" not null,
    -- 0: takes calls and does work; 1: takes calls alone; 2: does work alone.
    role smallint not null,
    version text not null,
    -- Where it takes calls; empty if it takes none.
    address text not null,
    -- The highest class of jobs that it does.
    class smallint not null,
    -- Jobs at work at once, and memory for them.
    places integer not null,
    host_bytes bigint not null,
    device_bytes bigint not null,
    -- Jobs of the database at work here, and the memory that all work here is planned to need.
    at_work integer not null,
    host_planned bigint not null,
    device_planned bigint not null,
    started bigint not null,
    seen bigint not null,
    -- Open calls by key, of keys that have a limit.
    open_calls jsonb not null default '{}',
    -- An operator wants it to take no more work.
    drain boolean not null default false
) with (fillfactor = 50, autovacuum_vacuum_scale_factor = 0.0, autovacuum_vacuum_threshold = 500);

-- Whether no process may be showing the bytes of an upload: its time is over, or the process was not heard of for a while.
create function tessera.is_free(showing bigint, shown_by bigint) returns boolean language sql volatile
    as $$ select showing <= tessera.now_ms() or exists (
        select from tessera.nodes n where n.process = shown_by and n.seen <= tessera.now_ms() - 15000) $$;

-- What all servers read and operators change, such as the keys of callers. A change names the version that it has seen.
create table tessera.documents (name text collate "C" primary key, version bigint not null, content text not null);

-- One process at a time sweeps: when the last one began.
alter table tessera.pulse add column swept bigint not null default 0;

-- jobs.class is the device that a job needs: 0 none, 1 a GPU. jobs.cost is predicted milliseconds of work.
alter table tessera.jobs
    -- Its tenant's share beside others.
    add column weight double precision not null default 1,
    -- Since when others go before it, since it does not fit the free memory of processes that could do it.
    add column passed bigint,
    -- The process that begins nothing else until this job fits, and until when.
    add column kept_for text collate "C",
    add column kept_until bigint;
create index jobs_turns on tessera.jobs (class, tenant, priority desc, id) where state = 0;
create index jobs_kept on tessera.jobs (kept_for) where state = 0 and kept_for is not null;

-- Start-time fair queueing: the virtual time of each tenant, seconds of work over its weight, and that at which the last job began.
create table tessera.shares (
    class smallint not null,
    tenant text collate "C" not null,
    time double precision not null,
    primary key (class, tenant)
);
create table tessera.turns (class smallint primary key, time double precision not null);

-- What is to be added to them. A claim adds a row, so that none waits for another; a sweep replaces many by their sum.
create table tessera.charges (
    class smallint not null,
    tenant text collate "C" not null,
    -- The virtual time at which a job began; null if none did.
    begun double precision,
    seconds double precision not null
) with (autovacuum_vacuum_scale_factor = 0.0, autovacuum_vacuum_threshold = 500);
create index charges_tenant on tessera.charges (class, tenant);
create index charges_begun on tessera.charges (class, begun) where begun is not null;

-- Where a class is: the virtual time at which its last job began.
create function tessera.turn(of_class smallint) returns double precision language sql volatile
    as $$ select greatest(
        coalesce((select time from tessera.turns where class = of_class), 0),
        coalesce((select max(begun) from tessera.charges where class = of_class and begun is not null), 0)) $$;

-- What a tenant has had.
create function tessera.share(of_class smallint, of_tenant text) returns double precision language sql volatile
    as $$ select coalesce((select time from tessera.shares where class = of_class and tenant = of_tenant), 0)
        + coalesce((select sum(seconds) from tessera.charges where class = of_class and tenant = of_tenant), 0) $$;

-- Locks the job that a process begins next, and charges its tenant; null if there is none. `free_` is the memory that is free at
-- the process now, `all_` what there is when nothing is at work. The tenant that has had least is first, one that comes new or comes back
-- has had as much as the others; then come priority and age. A job that does not fit the free memory is passed by for ten
-- seconds. Then the process keeps its memory for it.
create function tessera.next_job(
    own text, free_host bigint, free_device bigint, all_host bigint, all_device bigint, best smallint
) returns bytea language plpgsql volatile as $$
declare
    bypass constant bigint := 10000;
    hold constant bigint := 30000;
    now constant bigint := tessera.now_ms();
    line record;
    job record;
begin
    select id, class, tenant, cost, weight, host_bytes, device_bytes into job from tessera.jobs
        where state = 0 and kept_for = own and kept_until > now limit 1 for update skip locked;
    if found then
        if job.host_bytes <= free_host and job.device_bytes <= free_device then
            insert into tessera.charges (class, tenant, begun, seconds)
                values (job.class, job.tenant, null, job.cost / 1000.0 / job.weight);
            return job.id;
        end if;
        update tessera.jobs set kept_until = now + hold where id = job.id;
        return null;
    end if;
    for line in
        with recursive heads as (
            (select class, tenant, priority, id from tessera.jobs where state = 0 and class <= best
                order by class, tenant, priority desc, id limit 1)
            union all
            select n.class, n.tenant, n.priority, n.id from heads h cross join lateral (
                select j.class, j.tenant, j.priority, j.id from tessera.jobs j
                where j.state = 0 and j.class <= best and (j.class, j.tenant) > (h.class, h.tenant)
                order by j.class, j.tenant, j.priority desc, j.id limit 1) n
        ), turns as materialized (select c.class, tessera.turn(c.class) as turn from (select distinct class from heads) c)
        select h.class, h.tenant, t.turn, s.had
            from heads h join turns t on t.class = h.class
            cross join lateral (select tessera.share(h.class, h.tenant) as had) s
            order by greatest(s.had - t.turn, 0), h.priority desc, h.id
    loop
        select id, cost, weight, host_bytes, device_bytes, passed into job from tessera.jobs
            where state = 0 and class = line.class and tenant = line.tenant
                and host_bytes <= all_host and device_bytes <= all_device
                and (kept_for is null or kept_for = own or kept_until <= now)
            order by priority desc, id limit 1 for update skip locked;
        continue when not found;
        if job.host_bytes <= free_host and job.device_bytes <= free_device then
            -- One that had less begins where the others are.
            insert into tessera.charges (class, tenant, begun, seconds) values (line.class, line.tenant,
                greatest(line.had, line.turn), greatest(line.turn - line.had, 0) + job.cost / 1000.0 / job.weight);
            return job.id;
        end if;
        if job.passed is null then
            update tessera.jobs set passed = now where id = job.id;
        elsif now - job.passed >= bypass then
            update tessera.jobs set kept_for = own, kept_until = now + hold where id = job.id;
            return null;
        end if;
    end loop;
    return null;
end $$;

-- Replaces charges by their sums, and forgets tenants that have had no more than one that comes new. The caller is the only one.
create function tessera.settle() returns void language plpgsql volatile as $$
begin
    with gone as (delete from tessera.charges returning class, tenant, begun, seconds),
        begun as (
            insert into tessera.turns as t (class, time)
                select class, max(begun) from gone where begun is not null group by class
                on conflict (class) do update set time = greatest(t.time, excluded.time)
        )
        insert into tessera.shares as s (class, tenant, time)
            select class, tenant, sum(seconds) from gone group by class, tenant
            on conflict (class, tenant) do update set time = s.time + excluded.time;
    delete from tessera.shares s where s.time <= tessera.turn(s.class);
end $$;
