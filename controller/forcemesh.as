.PROGRAM fm.main() ;robot program: EXECUTE fm.main. Command processor, see README.md
  ; forcemesh, the program inside the controller. Protocol 1.
  ; This is not a safety function. Load, start and stop: README.md beside this file.
  ; fm.main  robot program: takes commands 1-3, 5, 6, 7 (start), 10, 11 from the ring; moves
  ; fm.send  PC program 1: sends 101, 102, 103 without end
  ; fm.recv  PC program 2: the socket; checks every packet; does 4, 8, 9, 12, 7 (stop) at once
  ; fm.watch PC program 3: watchdog; brakes, latches, watches the pendant and the other tasks
  ; No subroutine is called by two of them. Every variable has one task that writes it, named
  ; in fm.init; the exceptions are named there too. Loops carry their comments at line ends and
  ; behind RETURN, because a line with only a comment is a step.
  CALL fm.config
  CALL fm.begin
  CALL fm.init
  TOOL NULL
  BASE NULL
  CP ON
  SPEED 10 ALWAYS
  ACCURACY fm.accur ALWAYS
  ACCEL 100 ALWAYS
  DECEL 100 ALWAYS
  JMOVE #HERE ;no way to go: the first motion of a program takes longest to plan
  BREAK
  PCEXECUTE 3: fm.watch
  PCEXECUTE 1: fm.send
  PCEXECUTE 2: fm.recv
  TIMER 6=0
  WHILE fm.quit==0 DO
    WAIT (fm.rh<>fm.rt) OR (fm.wn<>fm.wu) OR (fm.hseq+fm.wseq<>fm.ack) OR (TIMER(6)>0.5)
    fm.loops=(fm.loops+1) MOD 1000000
    IF fm.hseq+fm.wseq<>fm.ack THEN ;a hold came
      CALL fm.halt
    END
    IF fm.rh<>fm.rt THEN
      CALL fm.take
    END
    IF fm.wn<>fm.wu THEN
      CALL fm.step
    END
    IF TIMER(6)>0.5 THEN
      CALL fm.tick
    END
  END
  CALL fm.leave
.END
.PROGRAM fm.config() ;what may be changed for a cell
  fm.port=49152 ;TCP port that is listened on, 8192 to 65535
  fm.accur=10 ;ACCURACY of every motion [mm]: larger than the spacing of a stream
  fm.tsend=0.008 ;pause of the sender between two samples [s]
  fm.twatch=0.02 ;pause of the watchdog between two looks [s]
  fm.still=0.03 ;all joints together turn slower than this at rest [deg/s]
  fm.lever=1.75 ;one degree of a turn counts as this many mm of way (100 mm/rad)
.END
.PROGRAM fm.begin() ;stop what an earlier run left; keep TOOL, BASE and CP for fm.leave
  IF TASK(1001)<>0 THEN
    PCABORT 1:
  END
  IF TASK(1002)<>0 THEN
    PCABORT 2:
  END
  IF TASK(1003)<>0 THEN
    PCABORT 3:
  END
  TIMER 6=0
  WAIT ((TASK(1001)<>1) AND (TASK(1002)<>1) AND (TASK(1003)<>1)) OR (TIMER(6)>5)
  IF EXISTREAL("fm.sock")==0 THEN
    fm.sock=0
  END
  IF EXISTREAL("fm.saved")==0 THEN
    fm.saved=0
  END
  CALL fm.frames
  ; An aborted run leaves TOOL and BASE null and fm.saved set: then the ones it kept are right.
  IF (fm.saved==0) OR (fm.null==0) THEN
    POINT fm.tool0=TOOL
    POINT fm.base0=BASE
    fm.cp0=ABS(SWITCH(CP))
    fm.saved=1
  END
.END
.PROGRAM fm.init() ;every global gets its value here, before the PC programs start
  ; written by fm.recv
  fm.link=0 ;1: connected and greeted, the sender may send
  fm.conn=0 ;number of the connection
  fm.hseq=0 ;holds by command 8, hello, or the end of a connection
  fm.stopn=0 ;commands 7 with Param 2
  fm.lack=0 ;the fm.lat that a hello has cleared
  fm.arm=0 ;1: something may move, so silence is a fault
  fm.heard=0 ;valid packets
  fm.framed=0 ;ID of the last one
  fm.hid=0 ;ID of the last command 8
  fm.rh=0 ;ring: next free slot
  fm.wn=0 ;wrenches received
  fm.wb=0 ;bank of the newest one
  fm.bad=0 ;the packet was not one
  fm.id=0 ;ID of the packet that comes next
  $fm.next="" ;the same, as it is written
  $fm.q="" ;the packet in hand
  fm.sp=50 ;scales, set by hello: packet units per mm,
  fm.so=500 ;degree of O, A, T,
  fm.sj=250 ;degree of a joint,
  fm.sf=100 ;N,
  fm.sm=1000 ;N m,
  fm.sv=10 ;mm/s
  ; written by fm.watch
  fm.wseq=0 ;holds by the watchdog
  fm.lat=0 ;times that it latched
  fm.bdone=-1 ;all braking for holds up to this fm.hseq+fm.wseq is over
  fm.gap=0 ;times that wrenches stayed away for three of their intervals
  fm.dropw=-1 ;connection that shall be closed
  fm.hw=0 ;status bits of the machine
  ; written by fm.send
  fm.drops=-1 ;connection that shall be closed
  fm.sbeat=0 ;samples
  fm.busy=0 ;1: inside TCP_SEND
  ; written by fm.main and its subroutines
  fm.quit=0 ;a person may set it to 1: fm.main ends and puts everything back
  fm.rt=0 ;ring: next slot to read
  fm.ack=-1 ;the fm.hseq+fm.wseq that was obeyed
  fm.rel=-1 ;the fm.hseq+fm.wseq after which something was let move: HELD ends
  fm.refd=0 ;1: the last target was refused
  fm.mode=0 ;force feedback: 1 position + 2 orientation
  fm.ffe=-1 ;the fm.hseq+fm.wseq+fm.stopn under which it started
  fm.ask=0 ;times that fm.main asked the watchdog to hold
  fm.wu=0 ;the last fm.wn that was used
  fm.gapu=0 ;the last fm.gap that was noticed
  fm.first=0 ;1: the next wrench is the first one
  fm.loops=0 ;turns of the loop of fm.main
  fm.null=1 ;1: TOOL and BASE are null
  fm.t0=0 ;TIMER(10) at the last iteration
  fm.v=50 ;program speed of commands 1 to 3 [mm/s]
  $fm.oat="" ;O, A, T of the last command 1
  ; written by fm.recv at a hello and by fm.take: ID of the last command taken
  fm.taken=0
  ; written by whoever finds a fault, cleared by fm.take: see README.md
  fm.fault=0
  ; limits of command 10
  fm.lstep=1 ;[mm]
  fm.lturn=0.5 ;[deg]
  fm.lspeed=10 ;[mm/s]
  fm.ltravel=20 ;[mm]
  fm.lforce=50 ;[N]
  fm.wd=0.25 ;watchdog [s]
  POINT fm.tcp=NULL ;command 11, in the flange frame
  POINT fm.itcp=NULL ;its inverse
  POINT fm.q0=NULL ;TCP to flange with the orientation at the start
  POINT fm.rot=NULL ;rotation since the start, base axes
  POINT fm.p=NULL ;target
  POINT #fm.j=#HERE ;target of a joint motion
  FOR .i=1 TO 6
    fm.kp[.i]=0 ;gains of command 6
    fm.ki[.i]=0
    fm.f[.i]=0 ;wrench of the iteration before
    fm.w[0,.i]=0 ;two banks for command 4
    fm.w[1,.i]=0
    fm.d[.i]=0 ;1-3: displacement since the start [mm]
    fm.c[.i]=0 ;1-3: TCP at the start [mm]
  END
  FOR .i=0 TO 63
    $fm.ring[.i]="" ;packets
    fm.ringe[.i]=-1 ;fm.hseq+fm.wseq when it came
    fm.rings[.i]=-1 ;fm.stopn when it came
  END
  FOR .i=1 TO 21
    $fm.t[.i]="" ;fields to send
  END
  FOR .i=1 TO 22
    $fm.rx[.i]="" ;what TCP_RECV brought
  END
  $fm.hi[1]="" ;our hello
  ; what fm.recv compares with
  $fm.digits="-0123456789"
  $fm.zero="000000 000000 000000 000000 000000 000000 "
  $fm.keys="000004 000000 000001 000000 000002 000000 000003 000000 000005 000000 "
  $fm.keys=$fm.keys+"000006 000000 000006 000001 000010 000000 000011 000000 "
  $fm.keys=$fm.keys+"000012 000000 000008 000000 000007 000000 000007 000001 000007 000002 "
.END
.PROGRAM fm.halt() ;a hold came: forget what was under way; old ring entries show by their tag
  fm.ack=fm.hseq+fm.wseq
  fm.mode=0
  fm.wu=fm.wn
  $fm.oat=""
.END
.PROGRAM fm.tick() ;twice a second: restart a PC program that an error has ended
  TIMER 6=0
  IF TASK(1003)<>1 THEN
    BRAKE
    fm.mode=0
    fm.fault=12
    PCEXECUTE 3: fm.watch
  END
  IF TASK(1002)<>1 THEN
    BRAKE
    fm.mode=0
    fm.fault=12
    PCEXECUTE 2: fm.recv
  END
  IF TASK(1001)<>1 THEN
    fm.fault=12
    PCEXECUTE 1: fm.send
  END
.END
.PROGRAM fm.frames() ;fm.null=1 when TOOL and BASE are null
  POINT .a=TOOL
  DECOMPOSE .x[1]=.a
  .s=ABS(.x[1])+ABS(.x[2])+ABS(.x[3])+ABS(.x[5])+ABS(SIN((.x[4]+.x[6])/2))
  POINT .a=BASE
  DECOMPOSE .x[1]=.a
  .s=.s+ABS(.x[1])+ABS(.x[2])+ABS(.x[3])+ABS(.x[5])+ABS(SIN((.x[4]+.x[6])/2))
  fm.null=ABS(.s<0.001)
.END
.PROGRAM fm.leave() ;end the PC programs and the connection, put back what was changed
  BREAK
  IF TASK(1002)<>0 THEN
    PCABORT 2:
  END
  IF TASK(1001)<>0 THEN
    PCABORT 1:
  END
  IF TASK(1003)<>0 THEN
    PCABORT 3:
  END
  TIMER 6=0
  WAIT ((TASK(1001)<>1) AND (TASK(1002)<>1) AND (TASK(1003)<>1)) OR (TIMER(6)>5)
  IF fm.sock>0 THEN
    TCP_CLOSE .r,fm.sock
    fm.sock=0
  END
  TCP_END_LISTEN .r,fm.port
  CALL fm.back
.END
.PROGRAM fm.restore() ;after an abort, if fm.main is not started again: EXECUTE fm.restore
  IF EXISTREAL("fm.saved")==0 GOTO none
  IF fm.saved==0 GOTO none
  CALL fm.leave
none:
  RETURN
.END
.PROGRAM fm.back() ;what fm.main changed; the speeds cannot be read, so they get AS's defaults
  TOOL fm.tool0
  BASE fm.base0
  IF fm.cp0==0 THEN
    CP OFF
  END
  SPEED 100 ALWAYS
  ACCURACY 1 ALWAYS
  ACCEL 100 ALWAYS
  DECEL 100 ALWAYS
  fm.saved=0
.END
.PROGRAM fm.take() ;one command from the ring
  .$q=$fm.ring[fm.rt]
  .e=fm.ringe[fm.rt]
  .n=fm.rings[fm.rt]
  fm.rt=(fm.rt+1) MOD 64
  IF (.e<>fm.ack) OR (fm.lat<>fm.lack) GOTO odd
fresh:
  .id=VAL($LEFT(.$q,6))
  .cmd=VAL($MID(.$q,9,5))
  IF .cmd==7 GOTO begin7
  .v[1]=VAL($MID(.$q,22,6))
  .v[2]=VAL($MID(.$q,29,6))
  .v[3]=VAL($MID(.$q,36,6))
  .v[4]=VAL($MID(.$q,43,6))
  .v[5]=VAL($MID(.$q,50,6))
  .v[6]=VAL($MID(.$q,57,6))
  fm.mode=fm.mode*ABS(fm.hseq+fm.wseq+fm.stopn==fm.ffe) ;stopped meanwhile
  IF (fm.mode<>0) AND ((.cmd<5) OR (.cmd==11)) GOTO refuse
  CASE .cmd OF
  VALUE 1: ;move to a pose, straight
    POINT fm.p=TRANS(.v[1]/fm.sp,.v[2]/fm.sp,.v[3]/fm.sp,.v[4]/fm.so,.v[5]/fm.so,.v[6]/fm.so)
    .bad=INRANGE(fm.p)
    IF fm.rel<>.e THEN ;the first motion after a hold
      CALL fm.release(.e,.bad)
    END
    fm.refd=ABS(.bad<>0)
    fm.taken=.id
    IF .bad<>0 GOTO done
    WAIT (fm.bdone==.e) OR (fm.hseq+fm.wseq<>.e)
    SPEED fm.v MM/S
    IF $MID(.$q,43,20)<>$fm.oat THEN ;it turns
      $fm.oat=$MID(.$q,43,20)
      CALL fm.turn
    END
    IF fm.hseq+fm.wseq<>.e GOTO done
    LMOVE fm.p
  VALUE 2,3: ;move to joint angles, by joint angles
    IF .cmd==3 THEN ;from where the joints are when the motion before has ended
      WAIT (fm.bdone==.e) OR (fm.hseq+fm.wseq<>.e)
      BREAK
      HERE #fm.j
      DECOMPOSE .x[1]=#fm.j
    ELSE
      FOR .i=1 TO 6
        .x[.i]=0
      END
    END
    FOR .i=1 TO 6
      .x[.i]=.x[.i]+.v[.i]/fm.sj
    END
    POINT #fm.j=#PPOINT(.x[1],.x[2],.x[3],.x[4],.x[5],.x[6])
    .bad=INRANGE(#fm.j)
    IF fm.rel<>.e THEN
      CALL fm.release(.e,.bad)
    END
    fm.refd=ABS(.bad<>0)
    fm.taken=.id
    IF .bad<>0 GOTO done
    WAIT (fm.bdone==.e) OR (fm.hseq+fm.wseq<>.e)
    $fm.oat=""
    SPEED fm.v MM/S
    IF fm.hseq+fm.wseq<>.e GOTO done
    JMOVE #fm.j
  VALUE 5: ;speeds
    IF (MINVAL(.v[1],.v[2],.v[3])<1) OR (MAXVAL(.v[1],.v[2],.v[3])>10000) GOTO refuse
    IF .v[4]<1 GOTO refuse
    ACCEL .v[1]/100 ALWAYS
    DECEL .v[2]/100 ALWAYS
    fm.v=.v[4]/fm.sv*.v[3]/10000 ;mechanical times modular; the monitor speed comes on top
    fm.taken=.id
  VALUE 6: ;gains
    IF MINVAL(.v[1],.v[2],.v[3],.v[4],.v[5],.v[6])<0 GOTO refuse
    FOR .i=1 TO 6
      IF $MID(.$q,15,6)=="000000" THEN
        fm.kp[.i]=.v[.i]/1000000
      ELSE
        fm.ki[.i]=.v[.i]/10000
      END
    END
    fm.taken=.id
  VALUE 10: ;limits of force feedback, and the watchdog's
    IF MINVAL(.v[1],.v[2],.v[3],.v[4],.v[5])<1 GOTO refuse
    IF (.v[6]<100) OR (.v[6]>2000) GOTO refuse
    fm.lstep=.v[1]/fm.sp
    fm.lturn=.v[2]/fm.so
    fm.lspeed=.v[3]/fm.sv
    fm.ltravel=.v[4]/fm.sp
    fm.lforce=.v[5]/fm.sf
    fm.wd=.v[6]/1000
    fm.taken=.id
  VALUE 11: ;TCP in the flange frame
    POINT fm.tcp=TRANS(.v[1]/fm.sp,.v[2]/fm.sp,.v[3]/fm.sp,.v[4]/fm.so,.v[5]/fm.so,.v[6]/fm.so)
    POINT fm.itcp=-fm.tcp
    fm.taken=.id
  END
done:
  RETURN
begin7: ;command 7, Param 0 or 1; one that came before a stop is void
  IF .n<>fm.stopn GOTO done
  WAIT (fm.bdone==.e) OR (fm.hseq+fm.wseq<>.e)
  IF fm.hseq+fm.wseq<>.e GOTO done
  IF fm.rel<>.e THEN
    .bad=0
    CALL fm.release(.e,.bad)
    IF .bad<>0 GOTO refuse
  END
  IF (fm.mode==0) OR (.e+.n<>fm.ffe) THEN ;not both: the first of them
    BREAK
    CALL fm.seed
    fm.mode=0
    fm.ffe=.e+.n
  END
  fm.first=1
  fm.mode=fm.mode BOR (1+VAL($MID(.$q,20,1)))
  fm.refd=0
  fm.taken=.id
  RETURN
refuse:
  fm.refd=1
  fm.taken=.id
  RETURN
odd: ;older than a hold, or the hold before it is not obeyed yet
  IF (.e<>fm.hseq+fm.wseq) OR (fm.lat<>fm.lack) GOTO done
  CALL fm.halt
  GOTO fresh
  ; A command counts as taken when it has been tested, and before it moves: so the next set
  ; point of a stream is on its way while LMOVE waits for the one before. fm.taken is written
  ; after fm.refd and fm.rel, and the sender reads it before them.
  ; LMOVE, not JMOVE: the way is a straight line of the flange, it keeps the configuration,
  ; and its speed is mm/s.
.END
.PROGRAM fm.release(.e,.bad) ;the first motion after a hold: HELD ends, if TOOL and BASE are null
  fm.fault=0
  CALL fm.frames
  IF fm.null==0 THEN
    fm.fault=8
    .bad=-1
  END
  fm.rel=.e
.END
.PROGRAM fm.turn() ;where a turn takes longer than the way, MM/S alone would not limit it
  HERE .h
  POINT .d=-.h+fm.p
  DECOMPOSE .x[1]=.d
  .s=SQRT(.x[1]*.x[1]+.x[2]*.x[2]+.x[3]*.x[3])
  .w=MINVAL(1,ABS(COS(.x[5]/2)*COS((.x[4]+.x[6])/2)))
  .a=2*ATAN2(SQRT(1-.w*.w),.w)
  IF (.a*fm.lever>.s) AND (.a*fm.lever>0.1*fm.v) THEN ;0.1 s is the shortest that SPEED takes
    SPEED .a*fm.lever/fm.v S
  END
.END
.PROGRAM fm.seed() ;force feedback starts from where the arm is
  HERE fm.p
  POINT .c=fm.p+fm.tcp
  DECOMPOSE .x[1]=.c
  FOR .i=1 TO 3
    fm.c[.i]=.x[.i]
    fm.d[.i]=0
  END
  POINT .c=TRANS(0,0,0,.x[4],.x[5],.x[6])
  POINT fm.q0=.c+fm.itcp
  POINT fm.rot=NULL
  fm.wu=fm.wn
  TIMER 10=0
  fm.t0=0
.END
.PROGRAM fm.step() ;one iteration of force feedback: a new wrench, a new target
  IF (fm.mode==0) OR (fm.hseq+fm.wseq+fm.stopn<>fm.ffe) GOTO over
again: ;copy one whole bank
  .n=fm.wn
  .b=fm.wb
  .f[1]=fm.w[.b,1]
  .f[2]=fm.w[.b,2]
  .f[3]=fm.w[.b,3]
  .f[4]=fm.w[.b,4]
  .f[5]=fm.w[.b,5]
  .f[6]=fm.w[.b,6]
  IF fm.wn<>.n GOTO again
  fm.wu=.n
  IF (fm.first<>0) OR (fm.gap<>fm.gapu) OR (fm.t0>300) GOTO anew
  .t=TIMER(10)
  .dt=MINVAL(.t-fm.t0,fm.wd)
  IF .dt<=0 GOTO done ;a coarse TIMER: wait for the next wrench
  fm.t0=.t
  IF SQRT(.f[1]*.f[1]+.f[2]*.f[2]+.f[3]*.f[3])>fm.lforce GOTO pushed
  IF (fm.mode BAND 1)==0 GOTO rotate
  .x=fm.kp[1]*(.f[1]-fm.f[1])+fm.ki[1]*.f[1]*.dt
  .y=fm.kp[2]*(.f[2]-fm.f[2])+fm.ki[2]*.f[2]*.dt
  .z=fm.kp[3]*(.f[3]-fm.f[3])+fm.ki[3]*.f[3]*.dt
  fm.f[1]=.f[1]
  fm.f[2]=.f[2]
  fm.f[3]=.f[3]
  .k=MINVAL(fm.lstep,fm.lspeed*.dt)/MAXVAL(SQRT(.x*.x+.y*.y+.z*.z),0.000001)
  .k=MINVAL(1,.k) ;shortened to the limits of command 10
  fm.d[1]=fm.d[1]+.k*.x
  fm.d[2]=fm.d[2]+.k*.y
  fm.d[3]=fm.d[3]+.k*.z
  IF SQRT(fm.d[1]*fm.d[1]+fm.d[2]*fm.d[2]+fm.d[3]*fm.d[3])>fm.ltravel GOTO too.far
rotate:
  IF (fm.mode BAND 2)==0 GOTO aim
  .x=fm.kp[4]*(.f[4]-fm.f[4])+fm.ki[4]*.f[4]*.dt
  .y=fm.kp[5]*(.f[5]-fm.f[5])+fm.ki[5]*.f[5]*.dt
  .z=fm.kp[6]*(.f[6]-fm.f[6])+fm.ki[6]*.f[6]*.dt
  fm.f[4]=.f[4]
  fm.f[5]=.f[5]
  fm.f[6]=.f[6]
  .a=SQRT(.x*.x+.y*.y+.z*.z)
  IF .a<0.00001 GOTO aim
  .o=ATAN2(.y,.x) ;the axis, as O and A of a z axis along it
  .p=ATAN2(SQRT(.x*.x+.y*.y),.z)
  .a=MINVAL(.a,fm.lturn,fm.lspeed*.dt/fm.lever)
  POINT .u=TRANS(0,0,0,.o,.p,0)
  POINT .m=-.u
  POINT fm.rot=.u+RZ(.a)+.m+fm.rot
aim:
  POINT fm.p=TRANS(fm.c[1]+fm.d[1],fm.c[2]+fm.d[2],fm.c[3]+fm.d[3])+fm.rot+fm.q0
  IF INRANGE(fm.p)<>0 GOTO no.reach
  SPEED fm.lspeed MM/S
  IF fm.hseq+fm.wseq+fm.stopn<>fm.ffe GOTO over
  LMOVE fm.p
done:
  RETURN
anew: ;nothing to compare with: no proportional kick, no time to integrate over
  fm.gapu=fm.gap
  fm.first=0
  FOR .i=1 TO 6
    fm.f[.i]=.f[.i]
  END
  TIMER 10=0
  fm.t0=0
  RETURN
over:
  fm.mode=0
  fm.wu=fm.wn
  RETURN
too.far:
  fm.fault=6
  GOTO give.up
pushed:
  fm.fault=7
  GOTO give.up
no.reach:
  fm.fault=9
give.up: ;hold by ourselves; the watchdog brakes on until the arm is still
  BRAKE
  fm.mode=0
  fm.ask=fm.ask+1
  fm.wu=fm.wn
  RETURN
  ; The law of the specification: displacement = displacement + P (f - f before) + I f dt. The
  ; rotation likewise, as a turn about one axis through the TCP, composed and never added.
.END
.PROGRAM fm.send() ;PC program 1, the sender
  .c=0
  .h=0
  fm.busy=0
  WHILE TRUE DO
    TWAIT fm.tsend
    fm.sbeat=(fm.sbeat+1) MOD 1000000
    IF fm.link==0 THEN
      TWAIT 0.05
      GOTO again
    END
    .a=1 ;first element to send, last one
    .b=16
    .h=(.h+1) MOD 8
    .c=(.c+1) MOD 488
    HERE .#j
    HERE .p
    DECOMPOSE .j[1]=.#j
    DECOMPOSE .x[1]=.p
    IF MINVAL(.x[1],.x[2],.x[3])*fm.sp<-99999 GOTO misfit
    IF MINVAL(.j[1],.j[2],.j[3],.j[4],.j[5],.j[6])*fm.sj<-99999 GOTO misfit
    $fm.t[1]=$RIGHT($ENCODE(/I7,1E6+fm.taken),6)+" 000101 "
    $fm.t[9]=$RIGHT($ENCODE(/I7,1E6+fm.framed),6)+" 000102 "
    .e=fm.hseq+fm.wseq
    .s=fm.hw+32*fm.mode*ABS(.e+fm.stopn==fm.ffe)+128*ABS(.e<>fm.rel)
    .s=.s+256*ABS(fm.lat<>fm.lack)+512*fm.refd
    $fm.t[2]=$RIGHT($ENCODE(/I7,1E6+2048*.c+.s),6)+" "
    $fm.t[10]=$fm.t[2]
    .k=fm.sp
  $fm.t[3]=$LEFT("-",ABS(.x[1]<0))+$RIGHT($ENCODE(/I7,1E6+ROUND(ABS(.x[1])*.k)),6-ABS(.x[1]<0))+" "
  $fm.t[4]=$LEFT("-",ABS(.x[2]<0))+$RIGHT($ENCODE(/I7,1E6+ROUND(ABS(.x[2])*.k)),6-ABS(.x[2]<0))+" "
  $fm.t[5]=$LEFT("-",ABS(.x[3]<0))+$RIGHT($ENCODE(/I7,1E6+ROUND(ABS(.x[3])*.k)),6-ABS(.x[3]<0))+" "
    .k=fm.so
  $fm.t[6]=$LEFT("-",ABS(.x[4]<0))+$RIGHT($ENCODE(/I7,1E6+ROUND(ABS(.x[4])*.k)),6-ABS(.x[4]<0))+" "
  $fm.t[7]=$LEFT("-",ABS(.x[5]<0))+$RIGHT($ENCODE(/I7,1E6+ROUND(ABS(.x[5])*.k)),6-ABS(.x[5]<0))+" "
  $fm.t[8]=$LEFT("-",ABS(.x[6]<0))+$RIGHT($ENCODE(/I7,1E6+ROUND(ABS(.x[6])*.k)),6-ABS(.x[6]<0))+" "
    .k=fm.sj
  $fm.t[11]=$LEFT("-",ABS(.j[1]<0))+$RIGHT($ENCODE(/I7,1E6+ROUND(ABS(.j[1])*.k)),6-ABS(.j[1]<0))+" "
  $fm.t[12]=$LEFT("-",ABS(.j[2]<0))+$RIGHT($ENCODE(/I7,1E6+ROUND(ABS(.j[2])*.k)),6-ABS(.j[2]<0))+" "
  $fm.t[13]=$LEFT("-",ABS(.j[3]<0))+$RIGHT($ENCODE(/I7,1E6+ROUND(ABS(.j[3])*.k)),6-ABS(.j[3]<0))+" "
  $fm.t[14]=$LEFT("-",ABS(.j[4]<0))+$RIGHT($ENCODE(/I7,1E6+ROUND(ABS(.j[4])*.k)),6-ABS(.j[4]<0))+" "
  $fm.t[15]=$LEFT("-",ABS(.j[5]<0))+$RIGHT($ENCODE(/I7,1E6+ROUND(ABS(.j[5])*.k)),6-ABS(.j[5]<0))+" "
  $fm.t[16]=$LEFT("-",ABS(.j[6]<0))+$RIGHT($ENCODE(/I7,1E6+ROUND(ABS(.j[6])*.k)),6-ABS(.j[6]<0))+" "
    IF .h<>0 GOTO write
health: ;now and then
    .b=21
    $fm.t[17]=$RIGHT($ENCODE(/I7,1E6+fm.taken),6)+" 000103 "
    .e=ERROR
    IF .e==0 THEN
      .e=fm.fault
    END
    $fm.t[18]=$LEFT("-",ABS(.e<0))+$RIGHT($ENCODE(/I7,1E6+ABS(.e)),6-ABS(.e<0))+" "
    .w=MINVAL(999999,ROUND(1000*TIMER(8)))
    $fm.t[19]=$RIGHT($ENCODE(/I7,1E6+fm.loops),6)+" "+$RIGHT($ENCODE(/I7,1E6+.w),6)+" "
    .w=(fm.rh-fm.rt+64) MOD 64
    .m=ROUND(100*MSPEED)
    $fm.t[20]=$RIGHT($ENCODE(/I7,1E6+.w),6)+" "+$RIGHT($ENCODE(/I7,1E6+.m),6)+" "
    $fm.t[21]=$RIGHT($ENCODE(/I7,1E6+fm.hid),6)+" 000000 "
write:
    fm.busy=1
    IF fm.link==0 GOTO sent
    .r=999
    TCP_SEND .r,fm.sock,$fm.t[.a],.b-.a+1,1
    WAIT .r<>999
    IF .r<0 THEN ;part of a packet may be out: this connection is spoiled
      fm.drops=fm.conn
      WAIT fm.link==0
    END
sent:
    fm.busy=0
    GOTO again
misfit: ;never clipped: no pose at all, and 103 says why
    fm.fault=10
    .a=17
    GOTO health
again:
  END
  ; A field is a sign and five digits, or six digits, and a space; made without the options /K
  ; and /L: 1000000 is added and the leading one cut off. TRUE is -1, so ABS makes it 1.
.END
.PROGRAM fm.recv() ;PC program 2, the receiver: the socket, and bytes to packets
  fm.link=0
  fm.arm=0
  fm.hseq=fm.hseq+1
  IF fm.sock>0 THEN
    TCP_CLOSE .r,fm.sock
    fm.sock=0
  END
  TCP_END_LISTEN .r,fm.port
listen:
  TCP_LISTEN .r,fm.port
  IF .r<0 THEN
    fm.fault=11
    TCP_END_LISTEN .r,fm.port
    TWAIT 1
    GOTO listen
  END
accept:
  .s=-999
  TCP_ACCEPT .s,fm.port,1
  WAIT .s<>-999
  IF .s==-34024 GOTO accept ;nobody came
  IF .s<=0 THEN
    TCP_END_LISTEN .r,fm.port
    TWAIT 1
    GOTO listen
  END
  fm.sock=.s
  fm.conn=(fm.conn+1) MOD 1000000
  $fm.next=""
  fm.bad=0
  .idle=0
  .$b=""
receive:
  .r=999
  .n=0
  TCP_RECV .r,fm.sock,$fm.rx[1],.n,1,189
  WAIT .r<>999
  IF (fm.dropw==fm.conn) OR (fm.drops==fm.conn) GOTO lost
  IF .r==-34024 THEN ;silence; the watchdog judges it, but not before a hello
    .idle=.idle+1
    IF (.idle>5) AND ($fm.next=="") GOTO lost
    GOTO receive
  END
  IF (.r<0) OR (.n<1) GOTO lost
  FOR .i=1 TO .n
    .$b=.$b+$fm.rx[.i] ;at most 62 characters of before and 189
    WHILE LEN(.$b)>=63 DO
      $fm.q=$LEFT(.$b,63)
      .$b=$MID(.$b,64)
      IF $fm.next=="" THEN
        CALL fm.hello
      ELSE
        CALL fm.packet
      END
      IF fm.bad<>0 GOTO lost
    END
  END
  GOTO receive
lost: ;hold, close, and listen for the next
  fm.link=0
  fm.arm=0
  fm.hseq=fm.hseq+1
  BRAKE
  TCP_CLOSE .r,fm.sock
  IF .r<0 THEN ;the second call forces it
    TCP_CLOSE .r,fm.sock
  END
  TIMER 4=0
  WAIT (fm.busy==0) OR (TIMER(4)>3) ;the next socket may get the same number
  fm.sock=0
  GOTO accept
.END
.PROGRAM fm.packet() ;one packet behind hello: check every character, then do it or queue it
  IF $LEFT($fm.q,7)<>$fm.next GOTO wrong ;IDs are consecutive
  .k=INSTR($fm.keys,$MID($fm.q,8,14)) ;Com and Param as a whole
  IF .k MOD 14<>1 GOTO wrong
  IF .k>126 THEN ;12, 8, 7: there is nothing in the vector
    .$s=$MID($fm.q,22)
    IF .$s<>$fm.zero GOTO wrong
  ELSE
    IF INSTR($fm.q,"E")>0 GOTO wrong ;VAL would read a power of ten
    .$s=$MID($fm.q,28,1)+$MID($fm.q,35,1)+$MID($fm.q,42,1)+$MID($fm.q,49,1)
    .$s=.$s+$MID($fm.q,56,1)+$MID($fm.q,63,1)
    IF .$s<>"      " GOTO wrong
    .$d=$fm.digits
    .$s=$MID($fm.q,22,1)+$MID($fm.q,29,1)+$MID($fm.q,36,1)+$MID($fm.q,43,1)
    .$s=.$s+$MID($fm.q,50,1)+$MID($fm.q,57,1)
    .a=MINVAL(INSTR(.$d,$MID(.$s,1,1)),INSTR(.$d,$MID(.$s,2,1)),INSTR(.$d,$MID(.$s,3,1)))
    .b=MINVAL(INSTR(.$d,$MID(.$s,4,1)),INSTR(.$d,$MID(.$s,5,1)),INSTR(.$d,$MID(.$s,6,1)))
    .c=MINVAL(VAL("1"+$MID($fm.q,23,5)),VAL("1"+$MID($fm.q,30,5)),VAL("1"+$MID($fm.q,37,5)))
    .d=MINVAL(VAL("1"+$MID($fm.q,44,5)),VAL("1"+$MID($fm.q,51,5)),VAL("1"+$MID($fm.q,58,5)))
    IF (MINVAL(.a,.b)<1) OR (MINVAL(.c,.d)<100000) GOTO wrong
  END
  IF .k==1 THEN ;4, the wrench
    .b=1-fm.wb ;the bank that nobody reads
    fm.w[.b,1]=VAL($MID($fm.q,22,6))/fm.sf
    fm.w[.b,2]=VAL($MID($fm.q,29,6))/fm.sf
    fm.w[.b,3]=VAL($MID($fm.q,36,6))/fm.sf
    fm.w[.b,4]=VAL($MID($fm.q,43,6))/fm.sm
    fm.w[.b,5]=VAL($MID($fm.q,50,6))/fm.sm
    fm.w[.b,6]=VAL($MID($fm.q,57,6))/fm.sm
    fm.wb=.b
    fm.wn=(fm.wn+1) MOD 1000000
    fm.arm=1
    GOTO framed
  END
  IF .k==127 THEN ;12, nothing to say
    fm.arm=1
    GOTO framed
  END
  IF .k==141 THEN ;8, hold
    fm.hseq=fm.hseq+1 ;voids the ring, force feedback, and the motion in hand
    fm.arm=0
    fm.hid=fm.id
    BRAKE
    GOTO framed
  END
  IF .k==183 THEN ;7, stop force feedback; the arm stays
    fm.stopn=fm.stopn+1
    fm.arm=1
    GOTO framed
  END
  .h=(fm.rh+1) MOD 64
  IF .h==fm.rt THEN ;nobody takes anything any more
    fm.fault=5
    fm.bad=1
    RETURN
  END
  $fm.ring[fm.rh]=$fm.q
  fm.ringe[fm.rh]=fm.hseq+fm.wseq
  fm.rings[fm.rh]=fm.stopn
  fm.rh=.h
  IF (.k<50) OR (.k>126) THEN ;1, 2, 3, 7; settings arm nothing
    fm.arm=1
  END
framed:
  fm.framed=fm.id
  fm.heard=(fm.heard+1) MOD 1000000
  fm.id=fm.id MOD 999999+1
  $fm.next=$RIGHT($ENCODE(/I7,1000000+fm.id),6)+" "
  RETURN
wrong: ;never guess a new start: the connection ends
  fm.fault=4
  fm.bad=1
  RETURN
  ; Keys stand in $fm.keys 14 characters apart: 4, 1, 2, 3, 5, 6/0, 6/1, 10, 11 from 1 to 113,
  ; then 12, 8, 7/0, 7/1, 7/2 from 127 to 183; a match between two keys is no key.
  ; A field is right when a sign or digit leads and "1" with the other five is 100000 or more:
  ; anything but digits would end the number for VAL before.
.END
.PROGRAM fm.hello() ;the first packet of a connection: only hello, and only it clears the latch
  fm.bad=1
  fm.fault=4
  IF INSTR($fm.q,"E")>0 GOTO done
  FOR .i=0 TO 8
    .v[.i]=VAL("1"+$MID($fm.q,7*.i+1,6))-1000000
    IF .v[.i]<0 GOTO done
    IF $MID($fm.q,7*.i+7,1)<>" " GOTO done
  END
  IF (.v[0]<1) OR (.v[1]<>9) GOTO done
  fm.fault=0
  fm.hseq=fm.hseq+1 ;whatever was under way is over
  fm.arm=0
  BRAKE
  .a=(.v[3]>9) AND (.v[3]<100) AND (.v[4]>99) AND (.v[4]<556) AND (.v[5]>49) AND (.v[5]<278)
  .b=(.v[6]>0) AND (.v[6]<1000) AND (.v[7]>9) AND (.v[7]<10000) AND (.v[8]>0) AND (.v[8]<1001)
  IF .a AND .b THEN ;others stay as they are, and the answer tells
    fm.sp=.v[3]
    fm.so=.v[4]
    fm.sj=.v[5]
    fm.sf=.v[6]
    fm.sm=.v[7]
    fm.sv=.v[8]
  END
  fm.taken=0
  fm.id=.v[0]
  fm.framed=fm.id
  fm.heard=(fm.heard+1) MOD 1000000
  $fm.hi[1]=$LEFT($fm.q,7)+"000009 000001 "+$RIGHT($ENCODE(/I7,1000000+fm.sp),6)+" "
  $fm.hi[1]=$fm.hi[1]+$RIGHT($ENCODE(/I7,1000000+fm.so),6)+" "
  $fm.hi[1]=$fm.hi[1]+$RIGHT($ENCODE(/I7,1000000+fm.sj),6)+" "
  $fm.hi[1]=$fm.hi[1]+$RIGHT($ENCODE(/I7,1000000+fm.sf),6)+" "
  $fm.hi[1]=$fm.hi[1]+$RIGHT($ENCODE(/I7,1000000+fm.sm),6)+" "
  $fm.hi[1]=$fm.hi[1]+$RIGHT($ENCODE(/I7,1000000+fm.sv),6)+" "
  .r=999
  TCP_SEND .r,fm.sock,$fm.hi[1],1,1
  WAIT .r<>999
  IF (.r<0) OR (.v[2]<>1) GOTO done ;another version has been told ours
  fm.id=fm.id MOD 999999+1
  $fm.next=$RIGHT($ENCODE(/I7,1000000+fm.id),6)+" "
  fm.lack=fm.lat
  fm.bad=0
  fm.link=1
done:
  RETURN
.END
.PROGRAM fm.watch() ;PC program 3, the watchdog
  fm.wseq=fm.wseq+1 ;nothing of before goes on, and a hello is needed
  fm.lat=fm.lat+1
  fm.dropw=fm.conn
  .heard=fm.heard
  .w=fm.wn
  .mode=0
  .ask=fm.ask
  .epoch=-1
  .need=0
  .mov=0
  .was=0
  .s=0
  .v=0
  .g=0
  .iv=0.05
  .lim=1
  .beat=fm.sbeat
  .quiet=0
  HERE .#j
  DECOMPOSE .j[11]=.#j
  TIMER 7=0
  TIMER 8=0
  TIMER 9=0
  WHILE TRUE DO
    TWAIT fm.twatch
    IF fm.heard<>.heard THEN
      .heard=fm.heard
      TIMER 7=0
    END
    IF fm.wn<>.w THEN
      .w=fm.wn
      .iv=0.8*.iv+0.2*MINVAL(TIMER(8),0.5) ;between two wrenches
      .lim=fm.wd
      TIMER 8=0
      .g=0
    END
    IF fm.mode<>.mode THEN
      .mode=fm.mode
      TIMER 8=0
      .lim=1 ;the first wrench comes when the PC has read that force feedback runs
    END
    IF (.mode<>0) AND (.g==0) AND (TIMER(8)>3*MAXVAL(.iv,fm.twatch)) THEN
      .g=1 ;the next wrench starts anew: none of the correction that was missed
      fm.gap=(fm.gap+1) MOD 1000000
    END
    .s=(.s+1)*ABS(fm.arm AND (TIMER(7)>fm.wd-0.05)) ;looks in a row that found silence
    .v=(.v+1)*ABS((.mode<>0) AND (TIMER(8)>.lim-0.05))
    .ok=ABS(((TASK(1)==1) OR (TASK(1)==3)) AND SWITCH(RUN) AND SWITCH(POWER))
    IF (.s>1) OR (.v>1) OR (.ok<.was) THEN
      IF fm.lat==fm.lack THEN
        fm.wseq=fm.wseq+1
        fm.lat=fm.lat+1
        BRAKE
        fm.dropw=fm.conn
        fm.fault=3
        IF .v>1 THEN
          fm.fault=2
        END
        IF .s>1 THEN
          fm.fault=1
        END
      END
      .s=0
      .v=0
    END
    IF (.ok>.was) OR (fm.ask<>.ask) THEN ;RUN on the pendant, or fm.main gave up
      .ask=fm.ask
      fm.wseq=fm.wseq+1
    END
    .was=.ok
    IF fm.hseq+fm.wseq<>.epoch THEN ;a hold: brake until the arm is still and fm.main knows
      .epoch=fm.hseq+fm.wseq
      .need=2
    END
    IF .need>0 THEN
      BRAKE
    END
    IF TIMER(9)>0.1 THEN
      .d=TIMER(9)
      TIMER 9=0
      HERE .#j
      DECOMPOSE .j[1]=.#j
      .x=ABS(.j[1]-.j[11])+ABS(.j[2]-.j[12])+ABS(.j[3]-.j[13])+ABS(.j[4]-.j[14])
      .x=.x+ABS(.j[5]-.j[15])+ABS(.j[6]-.j[16])
      DECOMPOSE .j[11]=.#j
      .mov=ABS(.x>fm.still*.d)
      IF .need>0 THEN
        IF (.mov==0) AND (fm.ack==.epoch) AND (.ok==1) THEN
          .need=.need-1
        ELSE
          .need=2
        END
        IF .need==0 THEN
          fm.bdone=.epoch
        END
      END
      .quiet=(.quiet+1)*ABS(fm.sbeat==.beat)
      .beat=fm.sbeat
      IF (.quiet>30) AND fm.link THEN ;the sender hangs: nobody reads what it sends
        fm.dropw=fm.conn
      END
    END
    .h=ABS(SWITCH(POWER))+2*ABS(SWITCH(REPEAT))+4*(1-ABS(SWITCH(TEACH_LOCK)))
    fm.hw=.h+8*ABS((TASK(1)==1) OR (TASK(1)==3))*ABS(SWITCH(RUN))+16*.mov+1024*ABS(SWITCH(ERROR))
  END
  ; A silence counts at the second look, so that after a freeze of the whole controller the
  ; receiver can read what came meanwhile before it is judged.
.END
