/* Counts what a process sends: preloaded in front of MPI by benchmarks/scaling.

   Messages are those between two ranks, of neighbourhood collectives one to each neighbour that
   gets something; persistent ones count whenever they start.  Here are the functions that DOLFINx,
   PETSc, Scotch, MUMPS, HDF5 and mpi4py call. */
#include <mpi.h>
#include <stdint.h>

enum { MESSAGES, BYTES, COLLECTIVES, COLLECTIVE_BYTES, ALLTOALLS, FILE_BYTES, KINDS };
double elastic_counts[KINDS];

static double size_of(double count, MPI_Datatype type) {
    int size = 0;
    if (count > 0) PMPI_Type_size(type, &size);
    return count * size;
}
static void message(double bytes) {
    elastic_counts[MESSAGES] += 1;
    elastic_counts[BYTES] += bytes;
}
static void collective(double bytes) {
    elastic_counts[COLLECTIVES] += 1;
    elastic_counts[COLLECTIVE_BYTES] += bytes;
}
/* One in which each rank receives something of every other one. */
static void to_all(double bytes) {
    elastic_counts[ALLTOALLS] += 1;
    collective(bytes);
}
static int ranks(MPI_Comm c) {
    int size;
    PMPI_Comm_size(c, &size);
    return size;
}
static double sum(const int n[], int count) {
    double all = 0;
    for (int i = 0; i < count; i++) all += n[i];
    return all;
}
/* To each neighbour as many as n says, or fixed where it says nothing. */
static void to_neighbours(const int *n, int fixed, MPI_Datatype t, MPI_Comm c) {
    int in, out = 0, weighted, kind;
    PMPI_Topo_test(c, &kind);
    if (kind == MPI_DIST_GRAPH) PMPI_Dist_graph_neighbors_count(c, &in, &out, &weighted);
    for (int i = 0; i < out; i++)
        if (n ? n[i] : fixed) message(size_of(n ? n[i] : fixed, t));
}

#define COUNT(NAME, PARAMETERS, ARGUMENTS, COUNTED)                                             \
    int MPI_##NAME PARAMETERS {                                                                 \
        COUNTED;                                                                                \
        return PMPI_##NAME ARGUMENTS;                                                           \
    }
#define PART const void *b, int n, MPI_Datatype t
#define PARTS const void *b, const int n[], const int d[], MPI_Datatype t
#define GETS void *rb, int rn, MPI_Datatype rt
#define GETS_PARTS void *rb, const int rn[], const int rd[], MPI_Datatype rt

/* ------------------------------------------------------- from rank to rank --- */

#define SEND(NAME)                                                                              \
    COUNT(NAME, (PART, int to, int tag, MPI_Comm c), (b, n, t, to, tag, c), message(size_of(n, t)))
#define ISEND(NAME)                                                                             \
    COUNT(NAME, (PART, int to, int tag, MPI_Comm c, MPI_Request *r), (b, n, t, to, tag, c, r),  \
          message(size_of(n, t)))
SEND(Send) SEND(Ssend) SEND(Rsend) SEND(Bsend) ISEND(Isend) ISEND(Issend) ISEND(Irsend)
COUNT(Sendrecv, (PART, int to, int tag, GETS, int from, int rtag, MPI_Comm c, MPI_Status *s),
      (b, n, t, to, tag, rb, rn, rt, from, rtag, c, s), message(size_of(n, t)))

/* Requests of persistent messages, by their handles. */
enum { SLOTS = 1 << 16 };
static struct { MPI_Request request; double bytes; } persistent[SLOTS];
static int slot_of(MPI_Request request) {
    int at = ((uintptr_t)request >> 4) % SLOTS;
    for (int n = 0; n < SLOTS && persistent[at].request && persistent[at].request != request; n++)
        at = (at + 1) % SLOTS;
    return at;
}
static void remember(MPI_Request request, double bytes) {
    int at = slot_of(request);
    persistent[at].request = request;
    persistent[at].bytes = bytes;
}
static void started(MPI_Request request) {
    int at = slot_of(request);
    if (persistent[at].request == request && persistent[at].bytes >= 0)
        message(persistent[at].bytes);
}
int MPI_Send_init(PART, int to, int tag, MPI_Comm c, MPI_Request *r) {
    int code = PMPI_Send_init(b, n, t, to, tag, c, r);
    remember(*r, size_of(n, t));
    return code;
}
int MPI_Recv_init(void *b, int n, MPI_Datatype t, int from, int tag, MPI_Comm c, MPI_Request *r) {
    int code = PMPI_Recv_init(b, n, t, from, tag, c, r);
    remember(*r, -1); /* the handle may have been one of a message sent */
    return code;
}
COUNT(Start, (MPI_Request *r), (r), started(*r))
COUNT(Startall, (int n, MPI_Request r[]), (n, r), for (int i = 0; i < n; i++) started(r[i]))

/* ----------------------------------------------------- from neighbour to neighbour --- */

COUNT(Neighbor_alltoall, (PART, GETS, MPI_Comm c), (b, n, t, rb, rn, rt, c),
      to_neighbours(0, n, t, c))
COUNT(Ineighbor_alltoall, (PART, GETS, MPI_Comm c, MPI_Request *r), (b, n, t, rb, rn, rt, c, r),
      to_neighbours(0, n, t, c))
COUNT(Neighbor_alltoallv, (PARTS, GETS_PARTS, MPI_Comm c), (b, n, d, t, rb, rn, rd, rt, c),
      to_neighbours(n, 0, t, c))
COUNT(Ineighbor_alltoallv, (PARTS, GETS_PARTS, MPI_Comm c, MPI_Request *r),
      (b, n, d, t, rb, rn, rd, rt, c, r), to_neighbours(n, 0, t, c))
COUNT(Neighbor_allgather, (PART, GETS, MPI_Comm c), (b, n, t, rb, rn, rt, c),
      to_neighbours(0, n, t, c))
COUNT(Ineighbor_allgather, (PART, GETS, MPI_Comm c, MPI_Request *r), (b, n, t, rb, rn, rt, c, r),
      to_neighbours(0, n, t, c))
COUNT(Ineighbor_allgatherv,
      (PART, void *rb, const int rn[], const int rd[], MPI_Datatype rt, MPI_Comm c, MPI_Request *r),
      (b, n, t, rb, rn, rd, rt, c, r), to_neighbours(0, n, t, c))

/* ------------------------------------------------------------------- along trees --- */

COUNT(Barrier, (MPI_Comm c), (c), collective(0))
COUNT(Ibarrier, (MPI_Comm c, MPI_Request *r), (c, r), collective(0))
COUNT(Bcast, (void *b, int n, MPI_Datatype t, int root, MPI_Comm c), (b, n, t, root, c),
      collective(size_of(n, t)))
COUNT(Reduce, (const void *b, void *rb, int n, MPI_Datatype t, MPI_Op o, int root, MPI_Comm c),
      (b, rb, n, t, o, root, c), collective(size_of(n, t)))
#define REDUCE(NAME)                                                                            \
    COUNT(NAME, (const void *b, void *rb, int n, MPI_Datatype t, MPI_Op o, MPI_Comm c),         \
          (b, rb, n, t, o, c), collective(size_of(n, t)))
#define IREDUCE(NAME)                                                                           \
    COUNT(NAME,                                                                                 \
          (const void *b, void *rb, int n, MPI_Datatype t, MPI_Op o, MPI_Comm c, MPI_Request *r), \
          (b, rb, n, t, o, c, r), collective(size_of(n, t)))
REDUCE(Allreduce) REDUCE(Scan) REDUCE(Exscan) IREDUCE(Iallreduce) IREDUCE(Iexscan)
COUNT(Gather, (PART, GETS, int root, MPI_Comm c), (b, n, t, rb, rn, rt, root, c),
      collective(b == MPI_IN_PLACE ? 0 : size_of(n, t)))
COUNT(Gatherv, (PART, GETS_PARTS, int root, MPI_Comm c), (b, n, t, rb, rn, rd, rt, root, c),
      collective(b == MPI_IN_PLACE ? 0 : size_of(n, t)))
COUNT(Scatter, (PART, GETS, int root, MPI_Comm c), (b, n, t, rb, rn, rt, root, c),
      collective(rb == MPI_IN_PLACE ? 0 : size_of(rn, rt)))
COUNT(Scatterv, (PARTS, GETS, int root, MPI_Comm c), (b, n, d, t, rb, rn, rt, root, c),
      collective(rb == MPI_IN_PLACE ? 0 : size_of(rn, rt)))

/* --------------------------------------------------------------- each rank to all --- */

COUNT(Allgather, (PART, GETS, MPI_Comm c), (b, n, t, rb, rn, rt, c),
      to_all(b == MPI_IN_PLACE ? size_of(rn, rt) : size_of(n, t)))
COUNT(Allgatherv, (PART, GETS_PARTS, MPI_Comm c), (b, n, t, rb, rn, rd, rt, c),
      to_all(b == MPI_IN_PLACE ? 0 : size_of(n, t)))
COUNT(Alltoall, (PART, GETS, MPI_Comm c), (b, n, t, rb, rn, rt, c),
      to_all(ranks(c) * (b == MPI_IN_PLACE ? size_of(rn, rt) : size_of(n, t))))
COUNT(Alltoallv, (PARTS, GETS_PARTS, MPI_Comm c), (b, n, d, t, rb, rn, rd, rt, c),
      to_all(b == MPI_IN_PLACE ? size_of(sum(rn, ranks(c)), rt) : size_of(sum(n, ranks(c)), t)))
COUNT(Reduce_scatter, (const void *b, void *rb, const int n[], MPI_Datatype t, MPI_Op o, MPI_Comm c),
      (b, rb, n, t, o, c), to_all(size_of(sum(n, ranks(c)), t)))
COUNT(Ireduce_scatter, (const void *b, void *rb, const int n[], MPI_Datatype t, MPI_Op o, MPI_Comm c,
      MPI_Request *r), (b, rb, n, t, o, c, r), to_all(size_of(sum(n, ranks(c)), t)))
COUNT(Reduce_scatter_block, (const void *b, void *rb, int n, MPI_Datatype t, MPI_Op o, MPI_Comm c),
      (b, rb, n, t, o, c), to_all(ranks(c) * size_of(n, t)))

/* ------------------------------------------------------------------------- files --- */

COUNT(File_write_at, (MPI_File f, MPI_Offset at, PART, MPI_Status *s), (f, at, b, n, t, s),
      elastic_counts[FILE_BYTES] += size_of(n, t))
COUNT(File_write_at_all, (MPI_File f, MPI_Offset at, PART, MPI_Status *s), (f, at, b, n, t, s),
      elastic_counts[FILE_BYTES] += size_of(n, t))
