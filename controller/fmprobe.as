.PROGRAM fp.main() ;robot program: EXECUTE fp.main. Measures this controller: docs/probe.md
  ; forcemesh probe 1. This is not a safety function. Loaded before forcemesh.as, never with it.
  ; Stage a, no motion: lines of forcemesh.as with their values, switches, times; printed.
  ; Stage b, no motion: the socket, by `forcemesh probe` on the PC.
  ; Stage c, 5 mm: only after fp.ok=1 on this controller's terminal and a yes on the PC.
  ; fp.main  robot program: stage a, then the commands that fp.tcp hands over
  ; fp.tcp   PC program 3: one-line commands in, lines `name value` out
  ; fp.guard PC program 4: samples the arm, brakes, holds, resets the errors that are expected
  ; fp.spin1 to 3 and fp.bad: PC programs 1 to 3 for a moment; each ends by itself
  ; No program of others is aborted. TOOL, BASE and speeds stay; CP is put back. TIMER 1 to 6.
  ONE fp.fail
  CALL fp.config
  CALL fp.init
  CALL fp.which
  CALL fp.room
  IF fp.on==0 GOTO taken
  CALL fp.state
  CALL fp.numbers
  CALL fp.texts
  CALL fp.poses
  CALL fp.times
  CALL fp.rates
  $fp.n="stage.a"
  fp.v=1
  CALL fp.put
  CALL fp.work
taken:
  RETURN
.END
.PROGRAM fp.config() ;what may be changed
  fp.port=49152 ;TCP port that is listened on, 8192 to 65535
  fp.ok=0 ;1: a person stands at the emergency stop, and stage c may move; one stage long
  fp.dur=1 ;how long each rate is measured [s]
.END
.PROGRAM fp.init() ;every global gets its value here
  fp.no=-987654 ;of a result: its line failed
  fp.on=0 ;0: every program of the probe ends
  fp.err=0 ;code of the last step that failed
  fp.nerr=0 ;number of steps that failed
  fp.v=fp.no ;a result
  $fp.n="" ;its name, and the expected value behind a space
  $fp.s="?"
  $fp.l=""
  $fp.o=""
  fp.nr=0 ;results in $fp.r
  fp.nb=0 ;results in $fp.b
  fp.sent=0 ;results of $fp.r that were sent
  fp.diff=0 ;lines with another value than expected
  fp.pc=0 ;lines that a PC program could execute
  fp.stop=0 ;1: the spinning programs end
  fp.c1=0
  fp.c2=0
  fp.c3=0
  fp.sock=0
  fp.conn=0 ;connections so far
  fp.code=0 ;result of the last TCP instruction
  fp.count=0
  fp.nrecv=0 ;TCP_RECV since the last command
  fp.end=0 ;kind of the end that the PC announces: 1 FIN, 2 RST, 3 unplugged; 4: flood
  fp.seq=0 ;commands for the robot program: handed over,
  fp.began=0 ;begun,
  fp.done=0 ;and done
  fp.cmd=0
  fp.clear=0 ;1: fp.guard shall reset a communication error or our own
  fp.terr=0 ;ERROR when fp.tcp had ended
  fp.stand=0 ;1: and it stood
  fp.rerr=0 ;ERROR when the robot program had stopped
  fp.nstop=0 ;times that it had
  fp.nrev=0 ;times that fp.tcp was started
  fp.go=0 ;1: stage c may move
  fp.cpset=0
  fp.cp0=0
  fp.k=1 ;actual speed divided by program speed in MM/S
  fp.m=1 ;the same in percent and in S: the monitor speed
  fp.samp=0 ;1: fp.guard samples
  fp.ns=0
  fp.dt=0.01 ;interval of samples [s]
  fp.brk=0 ;1: fp.guard brakes after half a millimetre; 2: it did
  fp.hld=0 ;the same for HOLD and CONTINUE
  fp.htask=0
  fp.hrun=0
  fp.hmm=0
  fp.x=0
  fp.moved=0 ;1: this run of the robot program has moved
  fp.cnt=0 ;motion instructions that were passed
  fp.snap=0 ;of them after half a second
  fp.w=0
  fp.gap=0 ;longest time between two passes of fp.guard [s]
  POINT fp.p0=NULL
  POINT #fp.j0=#HERE
  FOR .i=1 TO 6
    fp.a[.i]=0
    fp.j[.i]=0
  END
  FOR .i=0 TO 20
    $fp.rx[.i]=""
  END
  $fp.tx[1]=""
  $fp.words="list  echo  idle  flood end   quit  error go    stay  scale "
  $fp.words=$fp.words+"line  trace segs  ahead joint turn  brake hold  first "
  $fp.ends[0]="close"
  $fp.ends[1]="fin"
  $fp.ends[2]="rst"
  $fp.ends[3]="unplug"
  $fp.ends[4]="flood"
.END
.PROGRAM fp.which() ;tasks of programs that may be PC programs
  $fp.n="whichtask.fp.main"
  fp.v=WHICHTASK("fp.main")
  CALL fp.put
  $fp.n="whichtask.fm.send"
  fp.v=WHICHTASK("fm.send")
  CALL fp.put
  $fp.n="whichtask.fm.recv"
  fp.v=WHICHTASK("fm.recv")
  CALL fp.put
  $fp.n="whichtask.fm.watch"
  fp.v=WHICHTASK("fm.watch")
  CALL fp.put
  $fp.n="whichtask.autostart.pc"
  fp.v=WHICHTASK("autostart.pc")
  CALL fp.put
  $fp.n="whichtask.autostart2.pc"
  fp.v=WHICHTASK("autostart2.pc")
  CALL fp.put
  $fp.n="whichtask.autostart3.pc"
  fp.v=WHICHTASK("autostart3.pc")
  CALL fp.put
  $fp.n="whichtask.autostart4.pc"
  fp.v=WHICHTASK("autostart4.pc")
  CALL fp.put
  $fp.n="whichtask.autostart5.pc"
  fp.v=WHICHTASK("autostart5.pc")
  CALL fp.put
  $fp.n="whichtask.errstart.pc"
  fp.v=WHICHTASK("errstart.pc")
  CALL fp.put
.END
.PROGRAM fp.room() ;fp.on=1 when PC programs 1 to 4 are free: ours of an earlier run end now
  TIMER 1=0
  WAIT ((TASK(1003)==0) AND (TASK(1004)==0)) OR (TIMER(1)>5)
  $fp.n="task.1"
  fp.v=TASK(1001)
  CALL fp.put
  $fp.n="task.2"
  fp.v=TASK(1002)
  CALL fp.put
  $fp.n="task.3"
  fp.v=TASK(1003)
  CALL fp.put
  $fp.n="task.4"
  fp.v=TASK(1004)
  CALL fp.put
  $fp.n="task.5"
  fp.v=TASK(1005)
  CALL fp.put
  IF TASK(1001)+TASK(1002)+TASK(1003)+TASK(1004)==0 THEN
    fp.on=1
  ELSE
    PRINT "PC programs 1 to 4 must be free: PCSTATUS shows them. The probe aborts none."
  END
.END
.PROGRAM fp.fail() ;ONE: a step failed; the next one follows
  fp.err=ERROR
  fp.nerr=fp.nerr+1
  RETURNE
.END
.PROGRAM fp.put() ;a result: `name value`, or `name ? code`
  IF fp.v==fp.no THEN
    $fp.l=$fp.n+" ? "+$ENCODE(fp.err)
  ELSE
    $fp.l=$fp.n+" "+$ENCODE(fp.v)
  END
  CALL fp.say
.END
.PROGRAM fp.num() ;a line of forcemesh.as: `line.name expected value`
  IF fp.v==fp.no THEN
    $fp.l="line."+$fp.n+" ? "+$ENCODE(fp.err)
    fp.diff=fp.diff+1
  ELSE
    $fp.l="line."+$fp.n+" "+$ENCODE(fp.v)
    IF ABS(VAL($MID($fp.n,INSTR($fp.n," ")+1))-fp.v)>0.01 THEN
      fp.diff=fp.diff+1
      PRINT "the next line differs"
    END
  END
  CALL fp.say
.END
.PROGRAM fp.txt() ;the same for a string: `text.name /expected/ /value/`
  .i=INSTR($fp.n," ")
  .$w=$MID($fp.n,.i+1)
  $fp.l="text."+$LEFT($fp.n,.i)+"/"+.$w+"/ /"+$fp.s+"/"
  IF $fp.s<>.$w THEN
    fp.diff=fp.diff+1
    PRINT "the next line differs"
  END
  CALL fp.say
.END
.PROGRAM fp.say()
  fp.nr=fp.nr+1
  $fp.r[fp.nr]=$fp.l
  PRINT $fp.l
  fp.v=fp.no
  $fp.s="?"
  fp.err=0
.END
.PROGRAM fp.state() ;what a person or another program has set
  $fp.n="probe"
  fp.v=1
  CALL fp.put
  $fp.n="mspeed"
  fp.v=MSPEED
  CALL fp.put
  $fp.n="error"
  fp.v=ERROR
  CALL fp.put
  $fp.n="tool_mm"
  POINT .t=TOOL
  POINT .n=NULL
  fp.v=DISTANCE(.t,.n)
  CALL fp.put
  $fp.n="base_mm"
  POINT .t=BASE
  fp.v=DISTANCE(.t,.n)
  CALL fp.put
  $fp.n="switch.power"
  fp.v=SWITCH(POWER)
  CALL fp.put
  $fp.n="switch.repeat"
  fp.v=SWITCH(REPEAT)
  CALL fp.put
  $fp.n="switch.run"
  fp.v=SWITCH(RUN)
  CALL fp.put
  $fp.n="switch.teach_lock"
  fp.v=SWITCH(TEACH_LOCK)
  CALL fp.put
  $fp.n="switch.error"
  fp.v=SWITCH(ERROR)
  CALL fp.put
  $fp.n="switch.cp"
  fp.v=SWITCH(CP)
  CALL fp.put
  $fp.n="switch.abs.speed"
  fp.v=SWITCH(ABS.SPEED)
  CALL fp.put
  $fp.n="switch.qtool"
  fp.v=SWITCH(QTOOL)
  CALL fp.put
  $fp.n="switch.slow_start"
  fp.v=SWITCH(SLOW_START)
  CALL fp.put
  $fp.n="switch.singular"
  fp.v=SWITCH(SINGULAR)
  CALL fp.put
  $fp.n="switch.conf_variable"
  fp.v=SWITCH(CONF_VARIABLE)
  CALL fp.put
  $fp.n="switch.chg_interrupt_decel"
  fp.v=SWITCH(CHG_INTERRUPT_DECEL)
  CALL fp.put
  $fp.n="switch.cycle.stop"
  fp.v=SWITCH(CYCLE.STOP)
  CALL fp.put
  $fp.n="switch.prefetch.sigins"
  fp.v=SWITCH(PREFETCH.SIGINS)
  CALL fp.put
  $fp.n="switch.check.hold"
  fp.v=SWITCH(CHECK.HOLD)
  CALL fp.put
  $fp.n="switch.hold.step"
  fp.v=SWITCH(HOLD.STEP)
  CALL fp.put
  $fp.n="switch.rep_once"
  fp.v=SWITCH(REP_ONCE)
  CALL fp.put
  $fp.n="switch.stp_once"
  fp.v=SWITCH(STP_ONCE)
  CALL fp.put
  $fp.n="switch.rps"
  fp.v=SWITCH(RPS)
  CALL fp.put
  $fp.n="switch.trace"
  fp.v=SWITCH(TRACE)
  CALL fp.put
  $fp.n="switch.errstart.pc"
  fp.v=SWITCH(ERRSTART.PC)
  CALL fp.put
  $fp.n="switch.autostart.pc"
  fp.v=SWITCH(AUTOSTART.PC)
  CALL fp.put
  $fp.n="switch.autostart2.pc"
  fp.v=SWITCH(AUTOSTART2.PC)
  CALL fp.put
  $fp.n="switch.autostart3.pc"
  fp.v=SWITCH(AUTOSTART3.PC)
  CALL fp.put
  $fp.n="switch.autostart4.pc"
  fp.v=SWITCH(AUTOSTART4.PC)
  CALL fp.put
  $fp.n="switch.autostart5.pc"
  fp.v=SWITCH(AUTOSTART5.PC)
  CALL fp.put
.END
.PROGRAM fp.ref(.a) ;writes into the caller's variable
  .a=5
.END
.PROGRAM fp.numbers() ;lines of forcemesh.as that give a number
  $fp.n="round -6"
  fp.v=ROUND(-5.662)
  CALL fp.num
  $fp.n="abs.true 1"
  fp.v=ABS(3>2)
  CALL fp.num
  $fp.n="abs.and 1"
  fp.v=ABS((3>2) AND (2>1))
  CALL fp.num
  $fp.n="abs.or 1"
  fp.v=ABS((1>2) OR (2>1))
  CALL fp.num
  $fp.n="relation.sum 1"
  fp.v=ABS(1+2<>4)
  CALL fp.num
  $fp.n="mod 8"
  fp.v=7+3 MOD 2
  CALL fp.num
  $fp.n="bor 7"
  fp.v=5 BOR 2
  CALL fp.num
  $fp.n="power 8"
  fp.v=2^3
  CALL fp.num
  $fp.n="minval 1"
  fp.v=MINVAL(3,1,2,5,4,6)
  CALL fp.num
  $fp.n="maxval 7"
  fp.v=MAXVAL(1,2,3,4,5,7,6)
  CALL fp.num
  $fp.n="sqrt 3"
  fp.v=SQRT(9)
  CALL fp.num
  $fp.n="sin 0.5"
  fp.v=SIN(30)
  CALL fp.num
  $fp.n="cos 0.5"
  fp.v=COS(60)
  CALL fp.num
  $fp.n="atan2 45"
  fp.v=ATAN2(1,1)
  CALL fp.num
  $fp.n="exact 1999999"
  fp.v=1E6+999999
  CALL fp.num
  $fp.n="val.zeros -123"
  fp.v=VAL("-00123")
  CALL fp.num
  $fp.n="val.id 500123"
  fp.v=VAL($LEFT("500123 000001 ",6))
  CALL fp.num
  $fp.n="val.ends 112"
  fp.v=VAL("1"+"12 45")
  CALL fp.num
  $fp.n="instr 4"
  fp.v=INSTR("abcdefgh","DE")
  CALL fp.num
  $fp.n="instr.from 6"
  fp.v=INSTR(5,"1-2-3-4","-")
  CALL fp.num
  $fp.n="instr.none 0"
  fp.v=INSTR("-01234","5")
  CALL fp.num
  $fp.n="string.equal 0"
  fp.v=ABS($LEFT("abc",2)<>"ab")
  CALL fp.num
  $fp.n="string.case 0"
  fp.v=ABS("AB"=="ab")
  CALL fp.num
  $fp.n="string.250 250"
  .$b=""
  FOR .i=1 TO 25
    .$b=.$b+"0123456789"
  END
  fp.v=LEN(.$b)
  CALL fp.num
  $fp.n="array.2 5"
  fp.q[0,1]=5
  fp.v=fp.q[0,1]
  CALL fp.num
  $fp.n="array.local 7"
  .q[0]=7
  fp.v=.q[0]
  CALL fp.num
  $fp.n="for 4"
  FOR .i=1 TO 3
  END
  fp.v=.i
  CALL fp.num
  $fp.n="case 2"
  CASE 8+100*1 OF
  VALUE 1,108:
    fp.v=2
  VALUE 8:
    fp.v=3
  END
  CALL fp.num
  $fp.n="goto 1"
  fp.v=0
  IF fp.v==0 GOTO there
  fp.v=2
there:
  fp.v=fp.v+1
  CALL fp.num
  $fp.n="call 5"
  .a=1
  CALL fp.ref(.a)
  fp.v=.a
  CALL fp.num
  $fp.n="existreal 0"
  fp.v=EXISTREAL("fp.nothing")
  CALL fp.num
  $fp.n="existreal.yes 1"
  fp.v=ABS(EXISTREAL("fp.port"))
  CALL fp.num
  $fp.n="task 1"
  fp.v=TASK(1)
  CALL fp.num
  $fp.n="timer 1"
  TIMER 6=0
  fp.v=ABS(TIMER(6)<0.5)
  CALL fp.num
  $fp.n="wait 1"
  WAIT (fp.on==0) OR (TIMER(6)>0.05)
  fp.v=ABS(TIMER(6)>0.05)
  CALL fp.num
.END
.PROGRAM fp.texts() ;lines of forcemesh.as that give a string
  $fp.n="encode 1000012"
  $fp.s=$ENCODE(/I7,1E6+12)
  CALL fp.txt
  $fp.n="encode.id 1500001"
  $fp.s=$ENCODE(/I7,1500000+(500000+1) MOD 500000)
  CALL fp.txt
  .x=-12.6
  $fp.n="field.minus -00013"
  $fp.s=$LEFT("-",ABS(.x<0))+$RIGHT($ENCODE(/I7,1E6+ROUND(ABS(.x)*1)),6-ABS(.x<0))
  CALL fp.txt
  .x=12.6
  $fp.n="field.plus 000013"
  $fp.s=$LEFT("-",ABS(.x<0))+$RIGHT($ENCODE(/I7,1E6+ROUND(ABS(.x)*1)),6-ABS(.x<0))
  CALL fp.txt
  $fp.n="mid cd"
  $fp.s=$MID("abcdef",3,2)
  CALL fp.txt
  $fp.n="mid.rest f"
  $fp.s=$MID("abcdef",6)
  CALL fp.txt
  $fp.n="mid.beyond "
  $fp.s=$MID("abcdef",7)
  CALL fp.txt
  $fp.n="left.0 "
  $fp.s=$LEFT("abc",0)
  CALL fp.txt
  $fp.n="array ab"
  $fp.t[1]="a"
  $fp.t[2]="b"
  $fp.s=$fp.t[1]+$fp.t[2]
  CALL fp.txt
.END
.PROGRAM fp.poses() ;lines of forcemesh.as with poses
  POINT .a=TRANS(1000,0,0)
  POINT .b=TRANS(0,1000,0,60,0,0)
  POINT .c=.a+.b
  DECOMPOSE .x[1]=.c
  $fp.n="compose 1000"
  fp.v=.x[2]
  CALL fp.num
  POINT .c=.b+.a
  DECOMPOSE .x[1]=.c
  $fp.n="compose.x 500"
  fp.v=.x[1]
  CALL fp.num
  $fp.n="compose.y 1866.03"
  fp.v=.x[2]
  CALL fp.num
  POINT .m=-.b
  POINT .c=.m+.b
  POINT .n=NULL
  $fp.n="inverse 0"
  fp.v=DISTANCE(.c,.n)
  CALL fp.num
  POINT .c=.a-.b
  DECOMPOSE .x[1]=.c
  $fp.n="minus 133.97"
  fp.v=.x[1]
  CALL fp.num
  POINT .c=-.b+.a
  DECOMPOSE .x[1]=.c
  $fp.n="minus.plus -366.03"
  fp.v=.x[1]
  CALL fp.num
  POINT .c=RZ(30)+.a
  DECOMPOSE .x[1]=.c
  $fp.n="rz 866.03"
  fp.v=.x[1]
  CALL fp.num
  POINT .u=TRANS(0,0,0,10,20,0)
  POINT .m=-.u
  POINT .c=.u+RZ(30)+.m+.n
  DECOMPOSE .x[1]=.c
  $fp.n="turn 30"
  .w=MINVAL(1,ABS(COS(.x[5]/2)*COS((.x[4]+.x[6])/2)))
  fp.v=2*ATAN2(SQRT(1-.w*.w),.w)
  CALL fp.num
  POINT .#q=#PPOINT(1,2,3,4,5,6)
  DECOMPOSE .x[1]=.#q
  $fp.n="ppoint 6"
  fp.v=.x[6]
  CALL fp.num
  HERE .p
  HERE .#j
  POINT .c=.#j
  $fp.n="here 0"
  fp.v=DISTANCE(.p,.c)
  CALL fp.num
  $fp.n="inrange 0"
  fp.v=INRANGE(.p)
  CALL fp.num
  $fp.n="inrange.joints 0"
  fp.v=INRANGE(.#j)
  CALL fp.num
  $fp.n="inrange.far 32768"
  POINT .c=TRANS(99999,0,0)
  fp.v=INRANGE(.c)
  CALL fp.num
.END
.PROGRAM fp.times() ;grain of TIMER and of TWAIT
  .m=100
  .z=0
  .k=0
  .l=0
  TIMER 1=0
  DO
    .t[1]=TIMER(1)
    .t[2]=TIMER(1)
    .t[3]=TIMER(1)
    .t[4]=TIMER(1)
    .t[5]=TIMER(1)
    .t[6]=TIMER(1)
    .t[7]=TIMER(1)
    .t[8]=TIMER(1)
    FOR .i=1 TO 8
      IF .t[.i]>.l THEN
        .m=MINVAL(.m,.t[.i]-.l)
      ELSE
        .z=.z+1
      END
      .l=.t[.i]
    END
    .k=.k+8
  UNTIL .l>fp.dur
  $fp.n="timer.least_s"
  fp.v=.m
  CALL fp.put
  $fp.n="timer.reads"
  fp.v=.k
  CALL fp.put
  $fp.n="timer.equal"
  fp.v=.z
  CALL fp.put
  TIMER 1=0
  FOR .i=1 TO 100
    TWAIT 0.001
  END
  $fp.n="twait.1ms_s"
  fp.v=TIMER(1)/100
  CALL fp.put
  TIMER 1=0
  FOR .i=1 TO 50
    TWAIT 0.008
  END
  $fp.n="twait.8ms_s"
  fp.v=TIMER(1)/50
  CALL fp.put
.END
.PROGRAM fp.rate(.hz) ;steps a second of this task: ten steps a turn
  .n=0
  TIMER 1=0
  DO
    .n=.n+1
    .a=.n
    .b=.n
    .c=.n
    .d=.n
    .e=.n
    .f=.n
    .g=.n
  UNTIL TIMER(1)>fp.dur
  .t=TIMER(1)
  .hz=10*.n/.t
.END
.PROGRAM fp.rates() ;steps a second, alone and with three PC programs; lines that cost more
  .hz=0
  CALL fp.rate(.hz)
  $fp.n="steps.alone_hz"
  fp.v=.hz
  CALL fp.put
  .a=0
  TIMER 1=0
  FOR .i=1 TO 100
    CALL fp.ref(.a)
  END
  $fp.n="loop.call_s"
  fp.v=TIMER(1)/100
  CALL fp.put
  .x=-12.6
  TIMER 1=0
  FOR .i=1 TO 100
    .$f=$LEFT("-",ABS(.x<0))+$RIGHT($ENCODE(/I7,1E6+ROUND(ABS(.x)*1)),6-ABS(.x<0))
  END
  $fp.n="loop.field_s"
  fp.v=TIMER(1)/100
  CALL fp.put
  POINT .u=TRANS(0,0,0,10,20,0)
  TIMER 1=0
  FOR .i=1 TO 100
    POINT .c=.u+RZ(30)+.u
  END
  $fp.n="loop.pose_s"
  fp.v=TIMER(1)/100
  CALL fp.put
  TIMER 1=0
  FOR .i=1 TO 100
    HERE .p
  END
  $fp.n="loop.here_s"
  fp.v=TIMER(1)/100
  CALL fp.put
  PCEXECUTE 1: fp.spin1
  PCEXECUTE 2: fp.spin2
  PCEXECUTE 3: fp.spin3
  TWAIT 0.1
  fp.c1=0
  fp.c2=0
  fp.c3=0
  CALL fp.rate(.hz)
  .n=(fp.c1+fp.c2+fp.c3)*10
  fp.stop=1
  $fp.n="steps.robot_of_four_hz"
  fp.v=.hz
  CALL fp.put
  $fp.n="steps.three_pc_hz"
  fp.v=.n/fp.dur
  CALL fp.put
  TIMER 1=0
  WAIT (TASK(1001)+TASK(1002)+TASK(1003)==0) OR (TIMER(1)>2)
  $fp.n="pc.lines 6"
  fp.v=fp.pc
  CALL fp.num
  fp.stop=0
  PCEXECUTE 1: fp.spin2
  TWAIT 0.05
  PCABORT 1:
  TWAIT 0.05
  $fp.n="pcabort 0"
  fp.v=TASK(1001)
  CALL fp.num
  fp.stop=1
  $fp.n="differ"
  fp.v=fp.diff
  CALL fp.put
.END
.PROGRAM fp.spin1() ;PC program 1: lines that forcemesh.as has in PC programs, then steps
  fp.pc=1
  HERE .p
  fp.pc=2
  HERE .#j
  fp.pc=3
  DECOMPOSE .j[1]=.#j
  fp.pc=4
  .a=TASK(1)+TASK(1001)
  fp.pc=5
  .a=ABS(SWITCH(RUN))+ABS(SWITCH(ERROR))+MSPEED+ERROR
  fp.pc=6
  DO
    fp.c1=fp.c1+1
    .a=1
    .b=1
    .c=1
    .d=1
    .e=1
    .f=1
    .g=1
  UNTIL fp.stop<>0
.END
.PROGRAM fp.spin2()
  DO
    fp.c2=fp.c2+1
    .a=1
    .b=1
    .c=1
    .d=1
    .e=1
    .f=1
    .g=1
  UNTIL fp.stop<>0
.END
.PROGRAM fp.spin3()
  DO
    fp.c3=fp.c3+1
    .a=1
    .b=1
    .c=1
    .d=1
    .e=1
    .f=1
    .g=1
  UNTIL fp.stop<>0
.END
.PROGRAM fp.bad() ;PC program 1: an error on purpose, E0108
  TWAIT 0.2
  .a=0
  .b=1/.a
.END
.PROGRAM fp.again() ;robot program: fp.guard starts it after an error has stopped fp.main
  ONE fp.fail
  fp.moved=0
  IF fp.began<>fp.done THEN
    $fp.n="stopped"
    fp.v=fp.rerr
    fp.rerr=0
    CALL fp.put
    fp.done=fp.began
  END
  CALL fp.work
.END
.PROGRAM fp.work() ;the commands that fp.tcp hands over, until quit
turn:
  IF TASK(1004)==0 THEN
    PCEXECUTE 4: fp.guard
  END
  IF TASK(1003)==0 THEN
    CALL fp.revive
  END
  IF (fp.go==0) AND (fp.cpset<>0) THEN
    CALL fp.cpback
  END
  IF fp.on==0 GOTO over
  WAIT (fp.on==0) OR (fp.seq<>fp.done) OR (TASK(1003)==0) OR (TASK(1004)==0) OR (fp.cpset>fp.go)
  IF fp.seq==fp.done GOTO turn
  fp.began=fp.seq
  CASE fp.cmd OF
  VALUE 6: ;quit
    fp.on=0
  VALUE 7: ;error
    CALL fp.error
  VALUE 8: ;go
    CALL fp.begin
  VALUE 9: ;stay
    fp.go=0
  VALUE 10: ;scale
    fp.k=MINVAL(1,MAXVAL(0.01,fp.a[1]))
  ANY :
    IF fp.go==1 THEN
      CALL fp.move
    END
  END
  fp.done=fp.seq
  IF fp.on<>0 GOTO turn
over:
  CALL fp.cpback
.END
.PROGRAM fp.cpback()
  IF (fp.cpset<>0) AND (fp.cp0==0) THEN
    CP OFF
  END
  fp.cpset=0
.END
.PROGRAM fp.revive() ;start fp.tcp, also after an error has ended it
  fp.nrev=fp.nrev+1
  IF fp.nrev>20 THEN
    PRINT "fp.tcp ends again and again: is the TCP/IP option installed? The results are above."
    fp.on=0
    GOTO done
  END
  fp.terr=ERROR
  fp.stand=ABS(SWITCH(ERROR))
  IF fp.terr==0 THEN
    fp.terr=fp.rerr ;it has stopped fp.main too, and was reset
    fp.stand=ABS(fp.rerr<>0)
    fp.rerr=0
  ELSE
    fp.clear=1
    TIMER 1=0
    WAIT (fp.clear==0) OR (TIMER(1)>2)
  END
  PCEXECUTE 3: fp.tcp
done:
  RETURN
.END
.PROGRAM fp.error() ;what an error of a PC program does to others
  PCEXECUTE 1: fp.bad
  TWAIT 0.5
  $fp.n="pc_error.code"
  fp.v=ERROR
  CALL fp.put
  $fp.n="pc_error.stands"
  fp.v=ABS(SWITCH(ERROR))
  CALL fp.put
  fp.clear=1
  TIMER 1=0
  WAIT (fp.clear==0) OR (TIMER(1)>2)
  $fp.n="pc_error.after_reset"
  fp.v=ABS(SWITCH(ERROR))
  CALL fp.put
.END
.PROGRAM fp.begin() ;stage c: where it starts; go 1, or 0 while fp.ok is not 1, -1 out of reach
  fp.go=0
  $fp.n="go"
  IF fp.ok<>1 THEN
    fp.v=0
    GOTO said
  END
  HERE fp.p0
  HERE #fp.j0
  POINT .a=SHIFT(fp.p0 BY 0,0,5)
  fp.v=-1
  IF INRANGE(.a)<>0 GOTO said
  fp.ok=0
  fp.cp0=ABS(SWITCH(CP))
  fp.cpset=1
  CP ON
  fp.k=1
  fp.m=MINVAL(1,MAXVAL(0.01,MSPEED/100))
  fp.go=1
  fp.v=1
said:
  CALL fp.put
.END
.PROGRAM fp.home() ;back to where stage c started; not if a person has moved the arm
  fp.samp=0
  fp.brk=0
  fp.hld=0
  HERE .p
  IF DISTANCE(.p,fp.p0)>20 THEN
    fp.go=0
    $fp.n="moved_away"
    fp.v=1
    CALL fp.put
    GOTO done
  END
  SPEED 20/fp.k MM/S
  LMOVE fp.p0
  BREAK
  SPEED MINVAL(100,2/fp.m)
  JMOVE #fp.j0
  BREAK
done:
  RETURN
.END
.PROGRAM fp.move() ;one command of stage c: at most 5 mm up, 50 mm/s, 5 degrees of JT6
  fp.a[5]=fp.a[1]
  fp.a[1]=MINVAL(5,MAXVAL(0,fp.a[1]))
  .v=MINVAL(50,MAXVAL(0.1,fp.a[2]))/fp.k
  IF fp.cmd==19 GOTO first
  fp.moved=1
  CALL fp.home
  IF fp.go==0 GOTO done
  CASE fp.cmd OF
  VALUE 11:
    CALL fp.line(.v)
  VALUE 13:
    CALL fp.segs(.v)
  VALUE 14:
    CALL fp.ahead
  VALUE 15:
    CALL fp.joint
  VALUE 16:
    CALL fp.turn
  VALUE 17:
    CALL fp.brake
  VALUE 18:
    CALL fp.hold
  END
  .e=fp.nerr
  CALL fp.home
  IF fp.nerr<>.e THEN
    $fp.n="home_error"
    fp.v=fp.err
    CALL fp.put
  END
  GOTO done
first: ;the first motion of this run: no travel
  $fp.n="gap.moved"
  fp.v=fp.moved
  CALL fp.put
  fp.moved=1
  fp.gap=0
  TWAIT 0.3
  $fp.n="gap.idle_s"
  fp.v=fp.gap
  CALL fp.put
  fp.gap=0
  JMOVE #HERE
  BREAK
  TWAIT 0.1
  $fp.n="gap.first_s"
  fp.v=fp.gap
  CALL fp.put
  fp.gap=0
  JMOVE #HERE
  BREAK
  TWAIT 0.1
  $fp.n="gap.next_s"
  fp.v=fp.gap
  CALL fp.put
  TIMER 1=0
  FOR .i=1 TO 40
    BREAK
    .k=.i
  END
  .t=TIMER(1)
  TIMER 1=0
  FOR .i=1 TO 40
    BREAK
    JMOVE #HERE
  END
  $fp.n="planning_s"
  fp.v=(TIMER(1)-.t)/40 ;what one motion costs the program that gives it
  CALL fp.put
  BREAK
done:
  RETURN
.END
.PROGRAM fp.line(.v) ;up and back with samples: distance, speed, ACCEL and DECEL, interval
  POINT .a=SHIFT(fp.p0 BY 0,0,fp.a[1])
  fp.dt=fp.a[4]
  SPEED .v MM/S
  ACCEL MINVAL(100,MAXVAL(1,fp.a[3]))
  DECEL MINVAL(100,MAXVAL(1,fp.a[3]))
  TIMER 5=0
  fp.ns=0
  fp.samp=1
  TWAIT 0.05 ;fp.guard samples now
  TIMER 5=0 ;the time of a sample counts from here
  fp.ns=0
  LMOVE .a
  BREAK
  .t=TIMER(5)
  fp.samp=0
  $fp.n="move.took_s"
  fp.v=.t
  CALL fp.put
.END
.PROGRAM fp.segs(.v) ;short motions up: length of each, speed, how many
  .n=MINVAL(fp.a[3],5/MAXVAL(fp.a[1],0.01))
  .e=fp.nerr
  TIMER 1=0
  FOR .i=1 TO .n
    SPEED .v MM/S
    ACCURACY 10
    LMOVE SHIFT(fp.p0 BY 0,0,.i*fp.a[1])
    IF fp.nerr<>.e GOTO over
  END
over:
  .t=TIMER(1) ;the last one has been taken, so the others are done but for one or some
  BREAK
  fp.x=fp.err*ABS(fp.nerr<>.e)
  $fp.n="segs.code"
  fp.v=fp.x
  CALL fp.put
  $fp.n="segs.each_s"
  fp.v=.t/MAXVAL(1,.n-1)
  CALL fp.put
.END
.PROGRAM fp.ahead() ;motion instructions that are passed while the first one moves
  POINT fp.q1=SHIFT(fp.p0 BY 0,0,1)
  fp.cnt=0
  fp.snap=0
  TIMER 4=0
  fp.w=1
  SPEED 1/fp.k MM/S
  ACCURACY 10
  LMOVE fp.q1
  fp.cnt=1
  FOR .i=2 TO 8
    SPEED 4/fp.k MM/S
    ACCURACY 10
    LMOVE SHIFT(fp.p0 BY 0,0,0.5+0.5*.i)
    fp.cnt=.i
  END
  BREAK
  $fp.n="ahead"
  fp.v=fp.snap
  CALL fp.put
.END
.PROGRAM fp.joint() ;JT6 by up to 5 degrees: angle, speed, 0 % or 1 MM/S or 2 S
  .q=MINVAL(5,MAXVAL(-5,fp.a[5]))
  HERE .#a
  DECOMPOSE .x[1]=.#a
  POINT .#b=#PPOINT(.x[1],.x[2],.x[3],.x[4],.x[5],.x[6]+.q)
  IF INRANGE(.#b)<>0 THEN
    POINT .#b=#PPOINT(.x[1],.x[2],.x[3],.x[4],.x[5],.x[6]-.q)
  END
  TIMER 1=0
  CASE fp.a[3] OF
  VALUE 0:
    SPEED MINVAL(100,MAXVAL(0.01,MINVAL(5,fp.a[2])/fp.m))
  VALUE 1:
    SPEED MINVAL(50,fp.a[2])/fp.m MM/S
  ANY :
    SPEED MAXVAL(0.1,fp.a[2]*fp.m) S
  END
  JMOVE .#b
  BREAK
  .t=TIMER(1)
  $fp.n="joint.took_s"
  fp.v=.t
  CALL fp.put
.END
.PROGRAM fp.turn() ;the tool about its z axis: angle, speed, 1 MM/S or 2 S
  .q=MINVAL(5,MAXVAL(-5,fp.a[5]))
  POINT .a=fp.p0+RZ(.q)
  TIMER 1=0
  IF fp.a[3]==1 THEN
    SPEED MINVAL(50,fp.a[2])/fp.k MM/S
  ELSE
    SPEED MAXVAL(0.1,fp.a[2]*fp.m) S
  END
  LMOVE .a
  BREAK
  .t=TIMER(1)
  $fp.n="turn.took_s"
  fp.v=.t
  CALL fp.put
.END
.PROGRAM fp.brake() ;BRAKE of a PC program with a motion behind the present one
  POINT .a=SHIFT(fp.p0 BY 0,0,2)
  POINT .b=SHIFT(fp.p0 BY 0,0,5)
  fp.brk=1
  SPEED 4/fp.k MM/S
  ACCURACY 1
  LMOVE .a
  SPEED 4/fp.k MM/S
  LMOVE .b
  BREAK
  TWAIT 0.2
  BREAK
  HERE .p
  $fp.n="brake.done"
  fp.v=fp.brk
  CALL fp.put
  $fp.n="brake.mm"
  fp.v=DISTANCE(.p,fp.p0)
  CALL fp.put
.END
.PROGRAM fp.hold() ;HOLD and CONTINUE of a PC program
  POINT .a=SHIFT(fp.p0 BY 0,0,4)
  fp.hld=1
  SPEED 4/fp.k MM/S
  LMOVE .a
  BREAK
  TIMER 1=0
  WAIT (fp.hld==3) OR (TIMER(1)>2)
  BREAK
  HERE .p
  $fp.n="hold.task"
  fp.v=fp.htask
  CALL fp.put
  $fp.n="hold.run"
  fp.v=fp.hrun
  CALL fp.put
  $fp.n="hold.mm"
  fp.v=fp.hmm
  CALL fp.put
  $fp.n="hold.end_mm"
  fp.v=DISTANCE(.p,fp.p0)
  CALL fp.put
.END
.PROGRAM fp.guard() ;PC program 4
  .bad=0
  .l=0
  .last=-1
  TIMER 3=0
look:
  .t=TIMER(3)
  fp.gap=MAXVAL(fp.gap,.t-.l)
  .l=.t
  IF .t>1000 THEN
    .l=0
    TIMER 3=0
  END
  IF fp.on==0 GOTO over
  .bad=(.bad+1)*ABS((TASK(1)<>1) AND (TASK(1)<>3) AND SWITCH(RUN) AND SWITCH(POWER))
  IF .bad>10 GOTO stopped
  IF fp.samp+fp.brk+fp.hld<>0 GOTO watch
  IF (fp.w==1) AND (TIMER(4)>0.5) THEN
    fp.snap=fp.cnt
    fp.w=0
  END
  IF fp.clear<>0 THEN
    .e=ERROR
    IF (.e==-30108) OR (.e==-31117) OR (ABS(.e+34050)<50) THEN
      MC ERESET
    END
    fp.clear=0
  END
  TWAIT 0.01
  GOTO look
watch: ;while the arm moves
  HERE .p
  .d=DISTANCE(.p,fp.p0)
  IF (fp.samp<>0) AND (fp.ns<400) THEN
    .t=TIMER(5)
    IF (.t>=fp.ns*fp.dt) AND (.t<>.last) THEN ;at once when a coarse TIMER advances
      .last=.t
      fp.ns=fp.ns+1
      fp.st[fp.ns]=.t
      fp.sd[fp.ns]=.d
    END
    GOTO watch
  END
  IF (fp.brk==1) AND (.d>0.5) THEN
    BRAKE
    fp.brk=2
  END
  IF (fp.hld==1) AND (.d>0.5) THEN
    MC HOLD
    TWAIT 0.8
    HERE .p
    fp.hmm=DISTANCE(.p,fp.p0)
    fp.htask=TASK(1)
    fp.hrun=ABS(SWITCH(RUN))
    MC CONTINUE
    fp.hld=3
  END
  IF fp.brk+fp.hld>1 GOTO seen
  GOTO look
seen:
  TWAIT 0.01
  GOTO look
stopped: ;an error has stopped the robot program: reset, continue if it is the probe's
  .bad=0
  fp.rerr=ERROR
  fp.nstop=fp.nstop+1
  TWAIT 0.1
  IF fp.nstop>40 GOTO look
  IF (fp.rerr<>-30108) AND (fp.rerr<>-31117) AND (ABS(fp.rerr+34050)>=50) GOTO look
  MC ERESET
  MC EXECUTE fp.again
  TWAIT 0.1
  GOTO look
over:
  RETURN
  ; An error that is none of ours stands, and the robot program stays stopped: a person decides.
.END
.PROGRAM fp.tcp() ;PC program 3
  $fp.o=""
  IF fp.sock>0 THEN ;an error has ended the program before
    CALL fp.note(1)
    TCP_CLOSE .r,fp.sock
    fp.sock=0
  END
  TCP_END_LISTEN .r,fp.port
listen:
  IF fp.on==0 GOTO over
  TCP_LISTEN .r,fp.port
  IF .r<0 THEN
    TCP_END_LISTEN .r,fp.port
    TWAIT 0.5
    GOTO listen
  END
accept:
  IF fp.on==0 GOTO over
  TCP_ACCEPT .s,fp.port,1
  IF .s==-34024 GOTO accept
  IF .s<=0 THEN
    TCP_END_LISTEN .r,fp.port
    TWAIT 0.5
    GOTO listen
  END
  fp.sock=.s
  fp.conn=fp.conn+1
  fp.end=0
  fp.nrecv=0
  .$b=""
receive:
  IF fp.on==0 GOTO hang
  TCP_RECV fp.code,fp.sock,$fp.rx[1],fp.count,1,200
  IF fp.code==-34024 GOTO receive
  IF (fp.code<0) OR (fp.count<1) GOTO lost
  fp.nrecv=fp.nrecv+1
  FOR .i=1 TO fp.count
    .$b=$RIGHT(.$b,50)+$fp.rx[.i]
  END
cut:
  .i=INSTR(.$b,$CHR(10))
  IF .i==0 GOTO receive
  .$q=$LEFT(.$b,.i-1)
  .$b=$MID(.$b,.i+1)
  CALL fp.obey(.$q)
  fp.nrecv=0
  IF fp.code<0 GOTO lost
  GOTO cut
lost: ;closed by the PC, or broken
  CALL fp.note(0)
  fp.go=0
hang:
  TCP_CLOSE .r,fp.sock
  IF .r<0 THEN ;the second call forces it
    TCP_CLOSE .r,fp.sock
  END
  fp.sock=0
  IF fp.on<>0 GOTO accept
over:
  TCP_END_LISTEN .r,fp.port
.END
.PROGRAM fp.note(.ended) ;how a connection ended, for `list`
  fp.go=0
  .$k="end."+$fp.ends[fp.end]
  $fp.b[fp.nb+1]=.$k+".code "+$ENCODE(fp.code)
  $fp.b[fp.nb+2]=.$k+".count "+$ENCODE(fp.count)
  $fp.b[fp.nb+3]=.$k+".ended "+$ENCODE(.ended)
  fp.nb=fp.nb+3
  IF .ended<>0 THEN
    $fp.b[fp.nb+1]=.$k+".error "+$ENCODE(fp.terr)
    $fp.b[fp.nb+2]=.$k+".stands "+$ENCODE(fp.stand)
    fp.nb=fp.nb+2
  END
.END
.PROGRAM fp.out() ;one line to the PC
  IF fp.code<0 GOTO done
  $fp.tx[1]=$fp.o+$CHR(10)
  TCP_SEND fp.code,fp.sock,$fp.tx[1],1,1
done:
  RETURN
.END
.PROGRAM fp.obey(.$q) ;one command: a word and up to four numbers
  .i=INSTR(.$q," ")
  .$w=.$q
  IF .i>0 THEN
    .$w=$LEFT(.$q,.i-1)
  END
  .$r=.$q
  FOR .k=1 TO 4
    fp.a[.k]=0
    .i=INSTR(.$r," ")
    IF .i>0 THEN
      .$r=$MID(.$r,.i+1)
      fp.a[.k]=VAL(.$r)
    END
  END
  fp.cmd=(INSTR($fp.words,$LEFT(.$w+"      ",6))+5)/6
  fp.code=0
  CASE fp.cmd OF
  VALUE 1: ;list
    FOR .k=1 TO fp.nr
      $fp.o=$fp.r[.k]
      CALL fp.out
    END
    fp.sent=fp.nr
    FOR .k=1 TO fp.nb
      $fp.o=$fp.b[.k]
      CALL fp.out
    END
    $fp.o="connections "+$ENCODE(fp.conn)
    CALL fp.out
  VALUE 2: ;echo
    $fp.o="receives "+$ENCODE(fp.nrecv)
    CALL fp.out
  VALUE 3: ;idle
    CALL fp.idle
  VALUE 4: ;flood
    CALL fp.flood
  VALUE 5: ;end
    fp.end=MINVAL(3,MAXVAL(0,fp.a[1]))
  VALUE 12: ;trace
    FOR .k=1 TO fp.ns
      $fp.o="s "+$ENCODE(fp.st[.k])+" "+$ENCODE(fp.sd[.k])
      CALL fp.out
    END
  VALUE 6,7,8,9,10,11,13,14,15,16,17,18,19: ;of the robot program
    fp.sent=fp.nr
    fp.seq=fp.seq+1
    TIMER 2=0
    WAIT (fp.done==fp.seq) OR (TIMER(2)>120)
    FOR .k=fp.sent+1 TO fp.nr
      $fp.o=$fp.r[.k]
      CALL fp.out
    END
  ANY :
    $fp.o="unknown 1"
    CALL fp.out
  END
  $fp.o="done "+.$w
  CALL fp.out
.END
.PROGRAM fp.idle() ;how long TCP_RECV waits for 0.2 s and for 1.5 s
  FOR .k=1 TO 2
    .t=0.2+1.3*(.k-1)
    TIMER 2=0
    TCP_RECV .r,fp.sock,$fp.rx[1],.n,.t,200
    .u=TIMER(2)
    $fp.o="idle.asked_s "+$ENCODE(.t)
    CALL fp.out
    $fp.o="idle.waited_s "+$ENCODE(.u)
    CALL fp.out
    $fp.o="idle.code "+$ENCODE(.r)
    CALL fp.out
  END
.END
.PROGRAM fp.flood() ;TCP_SEND to a PC that does not read: how long one waits
  .$f=""
  FOR .k=1 TO 25
    .$f=.$f+"0123456789"
  END
  FOR .k=1 TO 16
    $fp.f[.k]=.$f
  END
  .m=0
  .n=0
  fp.end=4
  TIMER 6=0
more:
  TIMER 2=0
  TCP_SEND fp.code,fp.sock,$fp.f[1],16,1
  .m=MAXVAL(.m,TIMER(2))
  .n=.n+1
  IF (fp.code==0) AND (.m<0.9) AND (TIMER(6)<30) GOTO more
  $fp.b[fp.nb+1]="flood.code "+$ENCODE(fp.code)
  $fp.b[fp.nb+2]="flood.longest_s "+$ENCODE(.m)
  $fp.b[fp.nb+3]="flood.sends "+$ENCODE(.n)
  fp.nb=fp.nb+3
  fp.code=-1
.END
