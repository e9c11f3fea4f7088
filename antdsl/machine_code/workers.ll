; whole
declare void @llvm.memcpy.p0.p0.i64(ptr, ptr, i64, i1)
define internal ptr @at(ptr %pool, i64 %word) alwaysinline {
  %found = getelementptr i64, ptr %pool, i64 %word
  ret ptr %found
}
define internal i64 @word(ptr %pool, i64 %word) alwaysinline {
  %place = getelementptr i64, ptr %pool, i64 %word
  %found = load i64, ptr %place
  ret i64 %found
}
define internal i64 @now(ptr %pool, i64 %word) alwaysinline {
  %place = getelementptr i64, ptr %pool, i64 %word
  %found = load atomic i64, ptr %place seq_cst, align 8
  ret i64 %found
}
define internal ptr @object(ptr %pool, i64 %word) alwaysinline {
  %place = getelementptr i64, ptr %pool, i64 %word
  %found = load ptr, ptr %place
  ret ptr %found
}
define internal void @sleep(ptr %pool, ptr %lock) {
  %acquire = call ptr @object(ptr %pool, i64 $ACQUIRE$)
  %taken = call i32 %acquire(ptr %lock, i32 1)
  ret void
}
; Whether a flag was up, and is now down.
define internal i1 @lowered(ptr %flag) alwaysinline {
  %both = cmpxchg ptr %flag, i64 1, i64 0 seq_cst seq_cst
  %good = extractvalue {i64, i1} %both, 1
  ret i1 %good
}
define internal void @rouse(ptr %pool, ptr %flag, ptr %lock) {
  %sleeps = call i1 @lowered(ptr %flag)
  br i1 %sleeps, label %wake, label %end
wake:
  %release = call ptr @object(ptr %pool, i64 $RELEASE$)
  call void %release(ptr %lock)
  br label %end
end:
  ret void
}
define internal void @rouse.worker(ptr %pool, i64 %number) {
  %behind = mul i64 %number, $LINE$
  %flag.at = add i64 %behind, $SLEEPS$
  %lock.at = add i64 %flag.at, 1
  %flag = call ptr @at(ptr %pool, i64 %flag.at)
  %lock = call ptr @object(ptr %pool, i64 %lock.at)
  call void @rouse(ptr %pool, ptr %flag, ptr %lock)
  ret void
}
; Wake workers from a number on, no more of them than two, or than there are parts left.
define internal void @rouse.two(ptr %pool, i64 %first, i64 %left) {
entry:
  %workers = call i64 @word(ptr %pool, i64 $WORKERS$)
  br label %one
one:
  %k = phi i64 [ 0, %entry ], [ %next, %wake ]
  %which = add i64 %first, %k
  %there = icmp slt i64 %which, %workers
  %enough = icmp slt i64 %k, %left
  %both = and i1 %there, %enough
  %more = icmp slt i64 %k, 2
  %all = and i1 %both, %more
  br i1 %all, label %wake, label %end
wake:
  call void @rouse.worker(ptr %pool, i64 %which)
  %next = add i64 %k, 1
  br label %one
end:
  ret void
}
define internal void @part(ptr %pool, i64 %k) {
entry:
  %own = alloca [$WORDS$ x i64], align 16
  %code = call ptr @object(ptr %pool, i64 $CODE$)
  %table = call ptr @object(ptr %pool, i64 $TABLE$)
  %words = call i64 @word(ptr %pool, i64 $LENGTH$)
  %lists = icmp eq i64 %words, 0
  br i1 %lists, label %listed, label %laid
listed:
  %behind = mul i64 %k, 3
  %first = getelementptr i64, ptr %table, i64 %behind
  %address = load ptr, ptr %first
  %from = call i64 @word(ptr %first, i64 1)
  %to = call i64 @word(ptr %first, i64 2)
  call void %code(ptr %address, i64 %from, i64 %to)
  ret void
laid:
  %bytes = mul i64 %words, 8
  call void @llvm.memcpy.p0.p0.i64(ptr %own, ptr %table, i64 %bytes, i1 false)
  %parts = call i64 @word(ptr %pool, i64 $OF$)
  %count = call i64 @word(ptr %pool, i64 $COUNT$)
  %k.1 = add i64 %k, 1
  %some = mul i64 %count, %k
  %more = mul i64 %count, %k.1
  %some.k = udiv i64 %some, %parts
  %more.k = udiv i64 %more, %parts
  %begin = and i64 %some.k, $EVEN$
  %even = and i64 %more.k, $EVEN$
  %last = icmp eq i64 %k.1, %parts
  %end = select i1 %last, i64 %count, i64 %even
  %begin.to = getelementptr i64, ptr %own, i64 %words
  %begin.at = getelementptr i64, ptr %begin.to, i64 -2
  %end.at = getelementptr i64, ptr %begin.to, i64 -1
  store i64 %begin, ptr %begin.at
  store i64 %end, ptr %end.at
  call void %code(ptr %own, i64 0, i64 0)
  %given = call ptr @at(ptr %pool, i64 $GIVEN$)
  %rows = mul i64 %k, $RESULTS$
  %here = getelementptr i64, ptr %given, i64 %rows
  call void @llvm.memcpy.p0.p0.i64(ptr %here, ptr %own, i64 64, i1 false)
  ret void
}
; Take and do parts as long as there are any, from the first one on or from the last one back.
define internal void @work(ptr %pool, i1 %back) {
entry:
  %left.at = call ptr @at(ptr %pool, i64 $LEFT$)
  %done.at = call ptr @at(ptr %pool, i64 $DONE$)
  br label %look
look:
  %both.now = load atomic i64, ptr %left.at monotonic, align 8
  %left = and i64 %both.now, 4294967295
  %first = lshr i64 %both.now, 32
  %none = icmp eq i64 %left, 0
  br i1 %none, label %end, label %take
take:
  %step = select i1 %back, i64 -1, i64 4294967295
  %less = add i64 %both.now, %step
  %both = cmpxchg ptr %left.at, i64 %both.now, i64 %less seq_cst seq_cst
  %taken = extractvalue {i64, i1} %both, 1
  br i1 %taken, label %do, label %look
do:
  %parts = call i64 @word(ptr %pool, i64 $OF$)
  %after = add i64 %first, %left
  %last.one = sub i64 %after, 1
  %k = select i1 %back, i64 %last.one, i64 %first
  call void @part(ptr %pool, i64 %k)
  %before = atomicrmw add ptr %done.at, i64 1 seq_cst
  %now = add i64 %before, 1
  %last = icmp eq i64 %now, %parts
  br i1 %last, label %wake, label %look
wake:
  %flag = call ptr @at(ptr %pool, i64 $WAITS$)
  %lock = call ptr @object(ptr %pool, i64 $LOCK$)
  call void @rouse(ptr %pool, ptr %flag, ptr %lock)
  br label %look
end:
  ret void
}
define internal void @wait(ptr %pool) {
entry:
  %parts = call i64 @word(ptr %pool, i64 $OF$)
  %turns = call i64 @word(ptr %pool, i64 $TURNS$)
  %flag = call ptr @at(ptr %pool, i64 $WAITS$)
  %lock = call ptr @object(ptr %pool, i64 $LOCK$)
  br label %turn
turn:
  %k = phi i64 [ 0, %entry ], [ %next, %pause ], [ 0, %sleep ]
  %done = call i64 @now(ptr %pool, i64 $DONE$)
  %all = icmp eq i64 %done, %parts
  br i1 %all, label %end, label %not
not:
  %more = icmp slt i64 %k, %turns
  br i1 %more, label %pause, label %long
pause:
$PAUSE$  %next = add i64 %k, 1
  br label %turn
long:
  store atomic i64 1, ptr %flag seq_cst, align 8
  %still = call i64 @now(ptr %pool, i64 $DONE$)
  %now = icmp eq i64 %still, %parts
  br i1 %now, label %back, label %sleep
back:
  %own = call i1 @lowered(ptr %flag)
  br i1 %own, label %end, label %sleep
sleep:
  call void @sleep(ptr %pool, ptr %lock)
  br label %turn
end:
  ret void
}
define void @start(ptr %pool, i64 %a, i64 %b) {
  %parts = call i64 @word(ptr %pool, i64 $OF$)
  %done = call ptr @at(ptr %pool, i64 $DONE$)
  store atomic i64 0, ptr %done seq_cst, align 8
  %left = call ptr @at(ptr %pool, i64 $LEFT$)
  store atomic i64 %parts, ptr %left seq_cst, align 8
  call void @rouse.worker(ptr %pool, i64 0)
  ret void
}
define void @finish(ptr %pool, i64 %a, i64 %b) {
  %left = call ptr @at(ptr %pool, i64 $LEFT$)
  %both = atomicrmw xchg ptr %left, i64 0 seq_cst
  %nobodys = and i64 %both, 4294967295
  %done = call ptr @at(ptr %pool, i64 $DONE$)
  %before = atomicrmw add ptr %done, i64 %nobodys seq_cst
  call void @wait(ptr %pool)
  ret void
}
define void @all(ptr %pool, i64 %a, i64 %b) {
  call void @start(ptr %pool, i64 0, i64 0)
  call void @work(ptr %pool, i1 false)
  call void @wait(ptr %pool)
  ret void
}
define void @run(ptr %pool, ptr %code, ptr %table, i64 %words, i64 %parts) {
  %code.at = call ptr @at(ptr %pool, i64 $CODE$)
  store ptr %code, ptr %code.at
  %table.at = call ptr @at(ptr %pool, i64 $TABLE$)
  store ptr %table, ptr %table.at
  %words.at = call ptr @at(ptr %pool, i64 $LENGTH$)
  store i64 %words, ptr %words.at
  %parts.at = call ptr @at(ptr %pool, i64 $OF$)
  store i64 %parts, ptr %parts.at
  %last = sub i64 %words, 1
  %count = call i64 @word(ptr %table, i64 %last)
  %count.at = call ptr @at(ptr %pool, i64 $COUNT$)
  store i64 %count, ptr %count.at
  call void @all(ptr %pool, i64 0, i64 0)
  ret void
}
define void @worker(ptr %pool, i64 %number, i64 %b) {
entry:
  %turns = call i64 @word(ptr %pool, i64 $TURNS$)
  %behind = mul i64 %number, $LINE$
  %flag.at = add i64 %behind, $SLEEPS$
  %lock.at = add i64 %flag.at, 1
  %flag = call ptr @at(ptr %pool, i64 %flag.at)
  %lock = call ptr @object(ptr %pool, i64 %lock.at)
  %twice = mul i64 %number, 2
  %own = add i64 %twice, 1
  br label %turn
turn:
  %k = phi i64 [ 0, %entry ], [ %next, %pause ], [ 0, %busy ], [ %turns, %idle ]
  %over = call i64 @now(ptr %pool, i64 $END$)
  %ends = icmp ne i64 %over, 0
  br i1 %ends, label %end, label %look
look:
  %both = call i64 @now(ptr %pool, i64 $LEFT$)
  %left = and i64 %both, 4294967295
  %some = icmp ne i64 %left, 0
  br i1 %some, label %busy, label %none
busy:
  call void @rouse.two(ptr %pool, i64 %own, i64 %left)
  call void @work(ptr %pool, i1 true)
  br label %turn
none:
  %more = icmp slt i64 %k, %turns
  br i1 %more, label %pause, label %long
pause:
$PAUSE$  %next = add i64 %k, 1
  br label %turn
long:
  store atomic i64 1, ptr %flag seq_cst, align 8
  %both.still = call i64 @now(ptr %pool, i64 $LEFT$)
  %still = and i64 %both.still, 4294967295
  %end.now = call i64 @now(ptr %pool, i64 $END$)
  %any = or i64 %still, %end.now
  %come = icmp ne i64 %any, 0
  br i1 %come, label %back, label %sleep
back:
  %mine = call i1 @lowered(ptr %flag)
  br i1 %mine, label %idle, label %sleep
sleep:
  call void @sleep(ptr %pool, ptr %lock)
  br label %idle
idle:
  br label %turn
end:
  ret void
}
define void @end(ptr %pool, i64 %a, i64 %b) {
entry:
  %over = call ptr @at(ptr %pool, i64 $END$)
  store atomic i64 1, ptr %over seq_cst, align 8
  %workers = call i64 @word(ptr %pool, i64 $WORKERS$)
  br label %one
one:
  %k = phi i64 [ 0, %entry ], [ %next, %wake ]
  %more = icmp slt i64 %k, %workers
  br i1 %more, label %wake, label %end
wake:
  call void @rouse.worker(ptr %pool, i64 %k)
  %next = add i64 %k, 1
  br label %one
end:
  ret void
}
define void @turns(ptr %pool, i64 %count, i64 %b) {
entry:
  br label %turn
turn:
  %k = phi i64 [ 0, %entry ], [ %next, %turn ]
  %left = call i64 @now(ptr %pool, i64 $LEFT$)
$PAUSE$  %next = add i64 %k, 1
  %more = icmp slt i64 %next, %count
  br i1 %more, label %turn, label %end
end:
  ret void
}
