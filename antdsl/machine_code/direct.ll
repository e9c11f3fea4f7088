; whole
define internal i64 @word(ptr %of, i64 %at) alwaysinline {
  %place = getelementptr i8, ptr %of, i64 %at
  %found = load i64, ptr %place
  ret i64 %found
}
define internal ptr @object(ptr %of, i64 %at) alwaysinline {
  %place = getelementptr i8, ptr %of, i64 %at
  %found = load ptr, ptr %place
  ret ptr %found
}
define internal ptr @made(ptr %here, i64 %kind, ptr %place) {
  switch i64 %kind, label %truth [ i64 $REAL$, label %real  i64 $WHOLE$, label %whole  i64 $UNSIGNED$, label %unsigned ]
real:
  %r = load double, ptr %place
  %as.r = call ptr @call.PyFloat_FromDouble(ptr %here)
  %made.r = call ptr %as.r(double %r)
  ret ptr %made.r
whole:
  %w = load i64, ptr %place
  %as.w = call ptr @call.PyLong_FromLongLong(ptr %here)
  %made.w = call ptr %as.w(i64 %w)
  ret ptr %made.w
unsigned:
  %u = load i64, ptr %place
  %as.u = call ptr @call.PyLong_FromUnsignedLongLong(ptr %here)
  %made.u = call ptr %as.u(i64 %u)
  ret ptr %made.u
truth:
  %t = load i64, ptr %place
  %as.t = call ptr @call.PyBool_FromLong(ptr %here)
  %made.t = call ptr %as.t(i64 %t)
  ret ptr %made.t
}
define internal i1 @real(ptr %here, ptr %object, ptr %type, ptr %place) {
  %value = getelementptr i8, ptr %object, i64 $HEAD$
  %float = call ptr @float(ptr %here)
  %f64 = call ptr @f64(ptr %here)
  %f32 = call ptr @f32(ptr %here)
  %one = icmp eq ptr %type, %float
  %two = icmp eq ptr %type, %f64
  %either = or i1 %one, %two
  br i1 %either, label %double, label %other
double:
  %d = load double, ptr %value
  store double %d, ptr %place
  ret i1 true
other:
  %three = icmp eq ptr %type, %f32
  br i1 %three, label %single, label %none
single:
  %s = load float, ptr %value
  %wide = fpext float %s to double
  store double %wide, ptr %place
  ret i1 true
none:
  ret i1 false
}
define internal i1 @whole(ptr %here, ptr %object, ptr %type, ptr %place, i64 %kind) {
  %above = alloca i32
  %value = getelementptr i8, ptr %object, i64 $HEAD$
  %int = call ptr @int(ptr %here)
  %is.int = icmp eq ptr %type, %int
  %signed = icmp eq i64 %kind, $WHOLE$
  br i1 %is.int, label %python, label %no.int
python:
  br i1 %signed, label %long, label %unsigned
long:
  %as.long = call ptr @call.PyLong_AsLongLongAndOverflow(ptr %here)
  %l = call i64 %as.long(ptr %object, ptr %above)
  store i64 %l, ptr %place
  %too.large = load i32, ptr %above
  %fits = icmp eq i32 %too.large, 0
  ret i1 %fits
unsigned:
  %as.u = call ptr @call.PyLong_AsUnsignedLongLong(ptr %here)
  %u = call i64 %as.u(ptr %object)
  store i64 %u, ptr %place
  %doubtful = icmp eq i64 %u, -1
  br i1 %doubtful, label %clear, label %good
clear:
  %forget = call ptr @call.PyErr_Clear(ptr %here)
  call void %forget()
  ret i1 false
good:
  ret i1 true
no.int:
  %i64 = call ptr @i64(ptr %here)
  %u64 = call ptr @u64(ptr %here)
  %own = select i1 %signed, ptr %i64, ptr %u64
  %is.own = icmp eq ptr %type, %own
  br i1 %is.own, label %word, label %no.word
word:
  %w = load i64, ptr %value
  store i64 %w, ptr %place
  ret i1 true
no.word:
  %bool = call ptr @bool(ptr %here)
  %is.bool = icmp eq ptr %type, %bool
  br i1 %is.bool, label %truth, label %no.bool
truth:
  %true = call ptr @True(ptr %here)
  %t = icmp eq ptr %object, %true
  %t.wide = zext i1 %t to i64
  store i64 %t.wide, ptr %place
  ret i1 true
no.bool:
  %b8 = call ptr @b8(ptr %here)
  %is.b8 = icmp eq ptr %type, %b8
  br i1 %is.b8, label %byte, label %none
byte:
  %b = load i8, ptr %value
  %b.wide = zext i8 %b to i64
  store i64 %b.wide, ptr %place
  ret i1 true
none:
  ret i1 false
}
define internal i1 @array(ptr %here, ptr %object, ptr %type, ptr %place, ptr %step) {
entry:
  %ndarray = call ptr @array.type(ptr %here)
  %is.array = icmp eq ptr %type, %ndarray
  br i1 %is.array, label %look, label %none
look:
  %dtype = call i64 @word(ptr %object, i64 $DTYPE$)
  %dtype.expected = call i64 @word(ptr %step, i64 32)
  %axes.wide = call i64 @word(ptr %object, i64 $AXES$)
  %axes = and i64 %axes.wide, 4294967295
  %axes.expected = call i64 @word(ptr %step, i64 40)
  %flags = call i64 @word(ptr %object, i64 $FLAGS$)
  %flags.expected = call i64 @word(ptr %step, i64 48)
  %flags.there = and i64 %flags, %flags.expected
  %same.dtype = icmp eq i64 %dtype, %dtype.expected
  %same.axes = icmp eq i64 %axes, %axes.expected
  %same.flags = icmp eq i64 %flags.there, %flags.expected
  %some = and i1 %same.dtype, %same.axes
  %all = and i1 %some, %same.flags
  br i1 %all, label %good, label %none
good:
  %data = call i64 @word(ptr %object, i64 $HEAD$)
  store i64 %data, ptr %place
  %lengths = call ptr @object(ptr %object, i64 $LENGTHS$)
  %steps = call ptr @object(ptr %object, i64 $STEPS$)
  %size = call i64 @word(ptr %step, i64 56)
  %first = getelementptr i64, ptr %place, i64 1
  %second = getelementptr i64, ptr %first, i64 %axes
  %strided = icmp ne i64 %size, 0
  br label %axis
axis:
  %k = phi i64 [ 0, %good ], [ %next, %stepped ]
  %more = icmp slt i64 %k, %axes
  br i1 %more, label %length, label %done
length:
  %length.at = getelementptr i64, ptr %lengths, i64 %k
  %l = load i64, ptr %length.at
  %length.to = getelementptr i64, ptr %first, i64 %k
  store i64 %l, ptr %length.to
  br i1 %strided, label %stride, label %stepped
stride:
  %step.at = getelementptr i64, ptr %steps, i64 %k
  %s = load i64, ptr %step.at
  %whole.steps = sdiv i64 %s, %size
  %back = mul i64 %whole.steps, %size
  %step.to = getelementptr i64, ptr %second, i64 %k
  store i64 %whole.steps, ptr %step.to
  %exact = icmp eq i64 %back, %s
  br i1 %exact, label %stepped, label %none
stepped:
  %next = add i64 %k, 1
  br label %axis
done:
  ret i1 true
none:
  ret i1 false
}
define internal ptr @call(ptr %description, ptr %table, ptr %here) {
  %gone.call = call ptr @call.PyEval_SaveThread(ptr %here)
  %thread = call ptr %gone.call()
  %code = call ptr @object(ptr %description, i64 0)
  call void %code(ptr %table, i64 0, i64 0)
  %back.call = call ptr @call.PyEval_RestoreThread(ptr %here)
  call void %back.call(ptr %thread)
  %found = call ptr @given(ptr %description, ptr %table, ptr %here)
  ret ptr %found
}
; The same by the workers of a pool, which stands behind the arguments and the number of parts: a list of what each part gave.
define internal ptr @parted(ptr %description, ptr %table, ptr %here, ptr %run) {
entry:
  %words = call i64 @word(ptr %description, i64 56)
  %parts.at = getelementptr i64, ptr %table, i64 %words
  %parts = load i64, ptr %parts.at
  %pool.at = getelementptr i64, ptr %parts.at, i64 1
  %pool = load ptr, ptr %pool.at
  %list.call = call ptr @call.PyList_New(ptr %here)
  %set.call = call ptr @call.PyList_SetItem(ptr %here)
  %list = call ptr %list.call(i64 %parts)
  %failed = icmp eq ptr %list, null
  br i1 %failed, label %end, label %work
work:
  %gone.call = call ptr @call.PyEval_SaveThread(ptr %here)
  %thread = call ptr %gone.call()
  %code = call ptr @object(ptr %description, i64 0)
  call void %run(ptr %pool, ptr %code, ptr %table, i64 %words, i64 %parts)
  %back.call = call ptr @call.PyEval_RestoreThread(ptr %here)
  call void %back.call(ptr %thread)
  br label %fill
fill:
  %k = phi i64 [ 0, %work ], [ %next, %good ]
  %row = mul i64 %k, $GIVEN.STEP$
  %from.pool = add i64 %row, $GIVEN$
  %from = getelementptr i8, ptr %pool, i64 %from.pool
  %item = call ptr @given(ptr %description, ptr %from, ptr %here)
  %none = icmp eq ptr %item, null
  br i1 %none, label %undo, label %good
undo:
  %drop = call ptr @call.Py_DecRef(ptr %here)
  call void %drop(ptr %list)
  ret ptr null
good:
  %set = call i32 %set.call(ptr %list, i64 %k, ptr %item)
  %next = add i64 %k, 1
  %more = icmp slt i64 %next, %parts
  br i1 %more, label %fill, label %end
end:
  ret ptr %list
}
; What a table's first words are as an object.
define internal ptr @given(ptr %description, ptr %table, ptr %here) {
entry:
  %gives = call i64 @word(ptr %description, i64 32)
  switch i64 %gives, label %several [ i64 0, label %nothing  i64 1, label %one ]
nothing:
  %none = call ptr @None(ptr %here)
  %increase = call ptr @call.Py_IncRef(ptr %here)
  call void %increase(ptr %none)
  ret ptr %none
one:
  %kind = call i64 @word(ptr %description, i64 64)
  %single = call ptr @made(ptr %here, i64 %kind, ptr %table)
  ret ptr %single
several:
  %tuple.call = call ptr @call.PyTuple_New(ptr %here)
  %set.call = call ptr @call.PyTuple_SetItem(ptr %here)
  %tuple = call ptr %tuple.call(i64 %gives)
  %failed = icmp eq ptr %tuple, null
  br i1 %failed, label %end, label %fill
fill:
  %k = phi i64 [ 0, %several ], [ %next, %fill ]
  %kind.at = getelementptr i64, ptr %description, i64 %k
  %kind.k = call i64 @word(ptr %kind.at, i64 64)
  %from = getelementptr i64, ptr %table, i64 %k
  %item = call ptr @made(ptr %here, i64 %kind.k, ptr %from)
  %set = call i32 %set.call(ptr %tuple, i64 %k, ptr %item)
  %next = add i64 %k, 1
  %more = icmp slt i64 %next, %gives
  br i1 %more, label %fill, label %end
end:
  ret ptr %tuple
}
define ptr @direct(ptr %self, ptr %given, i64 %count) {
entry:
  %table = alloca [$WORDS$ x i64], align 16
  %stack = alloca [$DEPTH$ x ptr]
  %description = getelementptr i8, ptr %self, i64 $DESCRIPTION$
  %here = call ptr @object(ptr %description, i64 40)
  %count.expected = call i64 @word(ptr %description, i64 8)
  %steps = call i64 @word(ptr %description, i64 24)
  store ptr %given, ptr %stack
  %as.many = icmp eq i64 %count, %count.expected
  br i1 %as.many, label %argument, label %slow
argument:
  %k = phi i64 [ 0, %entry ], [ %next, %good ]
  %more = icmp slt i64 %k, %steps
  br i1 %more, label %look, label %ready
look:
  %behind = mul i64 %k, $STEP$
  %from = add i64 %behind, $FIRST$
  %step = getelementptr i8, ptr %description, i64 %from
  %what = call i64 @word(ptr %step, i64 0)
  %depth = call i64 @word(ptr %step, i64 8)
  %index = call i64 @word(ptr %step, i64 16)
  %word = call i64 @word(ptr %step, i64 24)
  %kind = call i64 @word(ptr %step, i64 32)
  %in.at = getelementptr ptr, ptr %stack, i64 %depth
  %in = load ptr, ptr %in.at
  %object.at = getelementptr ptr, ptr %in, i64 %index
  %object = load ptr, ptr %object.at
  %type = call ptr @object(ptr %object, i64 $TYPE$)
  %place = getelementptr i64, ptr %table, i64 %word
  switch i64 %what, label %number [ i64 $ARRAY$, label %array  i64 $TUPLE$, label %tuple ]
array:
  %array.good = call i1 @array(ptr %here, ptr %object, ptr %type, ptr %place, ptr %step)
  br i1 %array.good, label %good, label %slow
tuple:
  %type.flags = call i64 @word(ptr %type, i64 $TYPE.FLAGS$)
  %tuple.flag = and i64 %type.flags, $TUPLE.FLAG$
  %is.tuple = icmp ne i64 %tuple.flag, 0
  %size = call i64 @word(ptr %object, i64 $HEAD$)
  %as.long = icmp eq i64 %size, %kind
  %right = and i1 %is.tuple, %as.long
  %inside = getelementptr i8, ptr %object, i64 $INSIDE$
  %into = getelementptr ptr, ptr %in.at, i64 1
  store ptr %inside, ptr %into
  br i1 %right, label %good, label %slow
number:
  %is.real = icmp eq i64 %kind, $REAL$
  br i1 %is.real, label %real, label %whole
real:
  %real.good = call i1 @real(ptr %here, ptr %object, ptr %type, ptr %place)
  br i1 %real.good, label %good, label %slow
whole:
  %whole.good = call i1 @whole(ptr %here, ptr %object, ptr %type, ptr %place, i64 %kind)
  br i1 %whole.good, label %good, label %slow
good:
  %next = add i64 %k, 1
  br label %argument
ready:
  %run = call ptr @object(ptr %description, i64 48)
  %alone = icmp eq ptr %run, null
  br i1 %alone, label %at.once, label %apart
at.once:
  %made = call ptr @call(ptr %description, ptr %table, ptr %here)
  ret ptr %made
apart:
  %parts = call ptr @parted(ptr %description, ptr %table, ptr %here, ptr %run)
  ret ptr %parts
slow:
  %otherwise = call ptr @object(ptr %description, i64 16)
  %vectorcall = call ptr @call.PyObject_Vectorcall(ptr %here)
  %found = call ptr %vectorcall(ptr %otherwise, ptr %given, i64 %count, ptr null)
  ret ptr %found
}
