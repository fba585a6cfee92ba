-- The index of blobs: which are stored, whose they are, what pins them, uploads under way.
--
-- A process that takes a blob out locks its row for update first, and looks at its pins in a later statement. One that pins a
-- blob locks its row for key share first, several in the order of their digests. So a pin is never of a blob that is not there.

-- Microseconds since 1970.
create function tessera.now_us() returns bigint language sql volatile
    as $$ select floor(extract(epoch from clock_timestamp()) * 1000000)::bigint $$;

create sequence tessera.uses cache 32;

-- The time of a use, nanoseconds since 1970: the k-th use of a statement. The last three digits keep uses of the same
-- microsecond apart.
create function tessera.stamp(k bigint) returns bigint language sql volatile
    as $$ select (tessera.now_us() + k) * 1000 + nextval('tessera.uses') % 1000 $$;

-- Blobs whose bytes are stored.
create table tessera.blobs (
    digest bytea primary key check (octet_length(digest) = 32),
    size bigint not null,
    -- The time of the last use, nanoseconds since 1970; 0 for one that goes first.
    used bigint not null,
    -- Known to be pinned, so that no admission looks at it again. Set by an admission that met it, cleared with its last pin.
    -- It may stay set, if two processes take back the last two pins at once or the row is locked: a sweep, or an admission that
    -- finds no room, clears it then.
    held boolean not null default false
) with (autovacuum_vacuum_scale_factor = 0.05);
create index blobs_used on tessera.blobs (used, digest) where not held;
create index blobs_held on tessera.blobs (digest) where held;

-- How many blobs there are, and their bytes: the sums of all rows. Each statement that adds or removes blobs adds a row, so that
-- none waits for another; an admission replaces many by their sum.
create table tessera.amounts (
    blobs bigint not null,
    bytes bigint not null
) with (autovacuum_vacuum_scale_factor = 0.0, autovacuum_vacuum_threshold = 500);

create function tessera.count_blobs() returns trigger language plpgsql as $$
declare
    sign constant bigint := case tg_op when 'INSERT' then 1 else -1 end;
begin
    insert into tessera.amounts select sign * count(*), sign * sum(size) from changed having count(*) > 0;
    return null;
end $$;
create trigger blobs_added after insert on tessera.blobs
    referencing new table as changed for each statement execute function tessera.count_blobs();
create trigger blobs_removed after delete on tessera.blobs
    referencing old table as changed for each statement execute function tessera.count_blobs();

create table tessera.owners (
    digest bytea not null references tessera.blobs (digest) on delete cascade,
    owner bytea not null check (octet_length(owner) = 16),
    -- As in blobs: so that an owner's bytes are a sum over an index.
    size bigint not null,
    -- Rises: the oldest goes first.
    since bigint generated always as identity,
    primary key (digest, owner)
);
create index owners_owner on tessera.owners (owner, since) include (size);

create table tessera.pins (
    name text collate "C" not null,
    digest bytea not null references tessera.blobs (digest),
    -- In whose name; of all digests of a name the same.
    owner bytea,
    primary key (name, digest)
);
create index pins_digest on tessera.pins (digest, owner);

create function tessera.clear_held() returns trigger language plpgsql as $$
begin
    -- Waits for no lock: the transaction may hold others, in any order.
    with free as (
        select digest from tessera.blobs b
            where held and digest in (select digest from changed)
            and not exists (select from tessera.pins p where p.digest = b.digest)
            for no key update skip locked
    )
    update tessera.blobs b set held = false from free where b.digest = free.digest;
    return null;
end $$;
create trigger pins_removed after delete on tessera.pins
    referencing old table as changed for each statement execute function tessera.clear_held();

-- Blobs that left the index. Bytes that nothing removed, after a crash, are removed by a sweep. A row stays for a while after
-- that, so that a process that saw the bytes before does not enter them.
create table tessera.gone (
    digest bytea primary key,
    size bigint not null,
    -- When it left, milliseconds since 1970.
    since bigint not null,
    -- Until when a process may be removing its bytes, milliseconds since 1970.
    removing bigint not null default 0,
    -- Whether its bytes are removed; since says when.
    done boolean not null default false
);
create index gone_since on tessera.gone (done, since);

create table tessera.uploads (
    digest bytea not null,
    size bigint not null,
    -- Sixteen zeros for the server's own.
    owner bytea not null,
    -- When it was continued last, microseconds since 1970.
    touched bigint not null,
    -- Until when a process may be showing its bytes as the blob's, milliseconds since 1970, and which. Nothing removes them before,
    -- and no other process ends the upload.
    showing bigint not null default 0,
    shown_by bigint not null default 0,
    -- How far it is in an object store; not used yet.
    multipart text,
    kept bigint not null default 0,
    hash text,
    primary key (digest, size, owner)
) with (fillfactor = 70, autovacuum_vacuum_scale_factor = 0.0, autovacuum_vacuum_threshold = 500);

-- The parts that an object store has of an upload; not used yet.
create table tessera.upload_parts (
    digest bytea not null,
    size bigint not null,
    owner bytea not null,
    number integer not null,
    content text not null,
    primary key (digest, size, owner, number),
    foreign key (digest, size, owner) references tessera.uploads on delete cascade
);
